"""Machine code is loaded only from folders and files that no other user can have written."""

import os
import re
import stat

import pytest
from outputs import unfolded

from caster.jit import kernel_cache
from caster.jit.decorators import COMPILATION_LOG
from caster.jit.kernel_cache import cache_folder
from caster.system.terminal import compilation_reported, report_refused_cache

NEW = cache_folder.__wrapped__  # what it would be in a new process


@pytest.fixture
def home(tmp_path, monkeypatch):
    cache_folder()  # of this process, chosen before the environment changes
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kernel_cache.refusals.clear()
    report_refused_cache.cache_clear()
    yield tmp_path
    kernel_cache.refusals.clear()
    report_refused_cache.cache_clear()


def test_a_folder_of_this_user_alone_is_kept(home):
    folder = NEW()
    assert folder == home / "caster/kernels" and NEW() == folder
    assert not kernel_cache.refusals
    for each in (folder, folder.parent):
        assert stat.S_IMODE(each.stat().st_mode) == 0o700


@pytest.mark.parametrize("mode", [0o770, 0o720, 0o702, 0o777], ids=oct)
@pytest.mark.parametrize("above", range(2), ids=["kernels", "caster"])
def test_a_folder_that_others_may_write_is_not_used(home, mode, above):
    folder = NEW()
    opened = [folder, *folder.parents][above]
    opened.chmod(mode)
    instead = NEW()
    assert not instead.is_relative_to(home) and stat.S_IMODE(instead.stat().st_mode) == 0o700
    assert kernel_cache.refusals == [f"{opened}: other users may write it"]
    opened.chmod(0o700)
    assert NEW() == folder


def test_a_folder_of_another_user_is_not_used(home, monkeypatch):
    NEW()
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    assert not NEW().is_relative_to(home)
    assert kernel_cache.refusals == [f"{home / 'caster'}: it belongs to another user"]


def test_that_nothing_is_kept_is_stated_once_with_the_way_out(home, capsys):
    NEW().chmod(0o777)
    NEW()
    for _ in range(2):
        with compilation_reported():
            COMPILATION_LOG.compiling("a kernel")
    once, said, again = re.split("(?m)^(?=compiled)|^(?=compiling)", capsys.readouterr().err)[1:]
    assert once == again and once.startswith("compiling kernels")
    assert unfolded(said) == (
        f"compiled kernels are not kept: {home / 'caster/kernels'}: other users may write it; remove it, or name "
        "a folder of your own as XDG_CACHE_HOME"
    )
