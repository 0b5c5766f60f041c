"""No module needs POSIX to be imported, and on other platforms a command says where it runs."""

import pytest
from programs import python

# Modules of the standard library that Windows lacks.
POSIX_ALONE = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")
WITHOUT_POSIX = f"import sys; sys.modules.update(dict.fromkeys({POSIX_ALONE!r}))\n"
ON_WINDOWS = WITHOUT_POSIX + "sys.platform = 'win32'\n"
IMPORT_ALL = """
import importlib, pkgutil
import caster, mitsuba_ref
for package in (caster, mitsuba_ref):
    for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not found.name.endswith(("__main__", "mitsuba_calls", "pytest_plugin")):
            importlib.import_module(found.name)
print(len(sys.modules))
"""


def test_no_module_needs_posix_to_be_imported():
    found = python("-c", WITHOUT_POSIX + IMPORT_ALL)
    assert found.returncode == 0, found.stderr
    assert int(found.stdout) > 200


def test_a_name_of_the_package_says_where_it_runs():
    found = python("-c", ON_WINDOWS + "import caster; caster.render")
    last = found.stderr.strip().splitlines()[-1]
    assert found.returncode == 1 and last.startswith("ImportError: ") and "Windows Subsystem for Linux" in last


@pytest.mark.parametrize(("module", "words"), [("caster", ["--help"]), ("mitsuba_ref", ["validate"])])
def test_a_command_says_where_it_runs_and_nothing_else(module, words):
    code = f"from {module}.__main__ import main\nsys.exit(main({words!r}))"
    found = python("-c", ON_WINDOWS + code)
    assert found.returncode == 4 and not found.stdout
    assert found.stderr.count("\n") == 1 and "Windows Subsystem for Linux" in found.stderr
