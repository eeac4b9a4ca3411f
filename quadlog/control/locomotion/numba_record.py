"""State that compiled functions share: named arrays side by side in one record, handed over as one argument.

Every array that a compiled function is called with has to be unpacked; for a score of small ones that takes longer
than what is computed with them. A record is one argument, and the shapes of its fields are known to the compiler.
"""

from __future__ import annotations

from typing import Any, ClassVar, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

Bool = NDArray[np.bool_]


class Record:
    """One record of what a class annotates, arrays with their shapes as in `feet_m: Annotated[Float, 4, 3]`.

    record: (1,) for compiled functions; a view of each of its arrays is an attribute.

    What is true or false is a byte in it, for numba has no records of bools; its view is of bools. Single numbers have
    no views and are for compiled functions alone.
    """

    _layout: ClassVar[np.dtype[np.void]]

    def __init_subclass__(cls) -> None:
        hints = get_type_hints(cls, include_extras=True)
        fields = [(name, *(get_args(hints[name]) or (hints[name],))) for name in cls.__annotations__]
        types = [(name, "u1" if of == Bool else "f8", tuple(shape)) for name, of, *shape in fields]
        cls._layout = np.dtype(types, align=True)

    def __init__(self) -> None:
        self.record: NDArray[Any] = np.zeros(1, self._layout)
        for name in self._layout.names or ():
            field = self.record[name]
            if field.ndim > 1:
                setattr(self, name, field[0].view(np.bool_) if field.dtype == np.uint8 else field[0])
