"""Machine code of kernels alone, and not of the functions that are linked into them.

Numba writes machine code for every function that it compiles, also for those that only
other compiled functions call.  This is a seventh of the time that kernels take to
compile.  Here a function has machine code once somebody asks for it.

What a kernel links in belongs to it alone.  Numba lets equal names of several kernels
mean the code of the kernel that was loaded first, and names of functions only count the
functions that a process has compiled.  The last bits of a run would then depend on the
kernels that were loaded before.

Private interfaces of Numba that are used here (tried with 0.68.1): ``JITCodeLibrary``
with ``_final_module``, ``_finalize_final_module``, ``_ensure_finalized``,
``_finalized``, ``_object_caching_enabled``, ``_compiled_object``, ``codegen``,
``get_pointer_to_function`` and ``serialize_using_object_code``; ``_library_class`` of
its codegen; ``cpu_target``.
"""

# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import RLock

from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target

_compiling = RLock()  # one thread at a time compiles kernels


class LinkedLibrary(JITCodeLibrary):
    """The code of a function: optimised, and machine code where it is asked for."""

    _has_code = False

    def _finalize_final_module(self):
        """Write no machine code yet of code that has just been optimised."""
        self._finalized = True
        is_stored = self._object_caching_enabled and self._compiled_object is not None
        if is_stored:
            self._write()

    def _write(self):
        """Write machine code."""
        if self._has_code:
            return
        self._has_code = True
        for function in self._final_module.functions:
            if function.linkage.name == "linkonce_odr" and not function.is_declaration:
                function.linkage = "internal"
        super()._finalize_final_module()

    def get_pointer_to_function(self, name):
        """Return the address of a function, 0 if there is none of this name."""
        self._ensure_finalized()
        with suppress(NameError):
            self._final_module.get_function(name)
            self._write()
        if not self._has_code:
            return 0
        return super().get_pointer_to_function(name)

    def serialize_using_object_code(self):
        """Return what is stored of a kernel."""
        self._ensure_finalized()
        self._write()
        return super().serialize_using_object_code()

    @property
    def codegen(self):
        """Where Numba sets the environment of a function: nowhere without code."""
        return self._codegen if self._has_code else self

    def set_env(self, name, environment):
        """Leave out the environment of a function that has no code."""


@contextmanager
def linking_alone() -> Iterator[None]:
    """Let what is compiled inside ``with`` have a :class:`LinkedLibrary`."""
    codegen = cpu_target.target_context.codegen()
    with _compiling:
        codegen._library_class = LinkedLibrary
        try:
            yield
        finally:
            codegen._library_class = JITCodeLibrary
