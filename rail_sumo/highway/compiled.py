"""Functions as machine code: the one place that knows numba."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(signature: str) -> Callable[[Function], Function]:
    """Return a decorator that compiles a function for arguments and results of these types, in numba's notation.

    numba caches the machine code beside the function's file, or in the user's cache folder where that is read-only.
    Where the cache cannot be used, every process compiles anew, about a second a function. The cache notices
    changes of the function's own file only, so a compiled function uses nothing from other files of ours.

    Without fastmath, so that the machine code computes the same bits as the Python function, its `py_func`. Only a
    division by zero differs: it gives inf or nan, as in numpy.
    """

    def decorate(function: Function) -> Function:
        try:
            machine_code = numba.njit(signature, cache=True, error_model="numpy")(function)
        except Exception:  # no folder for the cache, a full disk, a damaged file; a fault of the function's comes again
            machine_code = numba.njit(signature, error_model="numpy")(function)
        return cast(Function, machine_code)

    return decorate
