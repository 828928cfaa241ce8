"""Modules that can be called, for names that are a module and a function: `station.fit(log)`, `station.fit.learner`.

Importing any submodule of a package puts the package, and not a function of its name, into the parent: the import of
`station.fit.learner` would undo a function `station.fit`. A module that can be called is right in either order.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module
from types import ModuleType


class CallableModule(ModuleType):
    """A module which, when it is called, calls its function of its own name; set as a module's `__class__`."""

    def __call__(self, *args: object, **kwargs: object) -> object:
        known = self.__signature__.parameters
        unknown = [name for name in kwargs if name not in known]
        if unknown:
            raise TypeError(f"{self.__name__}() has no argument '{unknown[0]}'; it has {', '.join(known)}")
        return self._function(*args, **kwargs)

    @property
    def _function(self) -> Callable[..., object]:
        return getattr(self, self.__name__.rpartition(".")[2])

    @property
    def __signature__(self) -> inspect.Signature:
        return inspect.signature(self._function)

    def __reduce__(self) -> tuple[Callable[[str], ModuleType], tuple[str]]:
        """By name, as functions are pickled: other processes can be given `station.fit`."""
        return import_module, (self.__name__,)
