"""Marks that several files of tests share."""

import pytest
from places import SHIPPED

from caster.jit.kernel_cache import COMPILED

each_shipped_scene = pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
compiled_only = pytest.mark.skipif(not COMPILED, reason="without Numba nothing is compiled")
