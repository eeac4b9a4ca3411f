"""State that compiled functions share: named arrays side by side in one record, handed over as one argument.

Every array that a compiled function is called with has to be unpacked; for a score of small ones that takes longer
than what is computed with them. A record is one argument, and the shapes of its fields are known to the compiler.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Record:
    """One record of a layout: `record` (1,) for compiled functions, and a view of each of its arrays as an attribute.

    What is true or false is a byte in it, for numba has no records of bools; its view is of bools. Single numbers have
    no views and are for compiled functions alone.
    """

    def __init__(self, layout: np.dtype[np.void]) -> None:
        self.record: NDArray[Any] = np.zeros(1, layout)
        for name in layout.names or ():
            field = self.record[name]
            if field.ndim > 1:
                setattr(self, name, field[0].view(np.bool_) if field.dtype == np.uint8 else field[0])
