"""Many runs: configs, cases, bodies, blocks, types, the Parquet store, the engine.

The package's interface has a function of this room's name, and importing a room puts it in the
package under that name.  So the room can be called, and is that function then.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class _Room(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        # By its name: no room imports what stands to its left.
        return import_module("rattlesweep.api").sweep(*args, **kwargs)


sys.modules[__name__].__class__ = _Room
