"""State that compiled functions share: named arrays side by side in one record, handed over as one argument.

Every array that a compiled function is called with has to be unpacked; for a score of small ones that takes longer
than what is computed with them. A record is one argument, and the shapes of its fields are known to the compiler.
"""

from __future__ import annotations

from functools import cache
from typing import Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

Bool = NDArray[np.bool_]


@cache
def _layout(kind: type[Record]) -> np.dtype[np.void]:
    fields = [(name, *(get_args(of) or (of,))) for name, of in get_type_hints(kind, include_extras=True).items()]
    return np.dtype([(name, "u1" if of == Bool else "f8", tuple(shape)) for name, of, *shape in fields], align=True)


class Record:
    """One record of what a class annotates, arrays with their shapes as in `feet_m: Annotated[Float, 4, 3]`.

    record: (1,) for compiled functions; a view of each of its arrays is an attribute.

    What is true or false is a byte in it, for numba has no records of bools; its view is of bools. Single numbers have
    no views and are for compiled functions alone.
    """

    def __init__(self) -> None:
        self.record: NDArray[Any] = np.zeros(1, _layout(type(self)))
        for name in self.record.dtype.names or ():
            field = self.record[name]
            if field.ndim > 1:
                setattr(self, name, field[0].view(np.bool_) if field.dtype == np.uint8 else field[0])
