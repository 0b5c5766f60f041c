"""The doctor names what is missing, what it would add and the way out, and never dies of what it looks at."""

import importlib.metadata
import json
import re
import sys
import tomllib
from pathlib import Path

import pytest

from caster.cli import installation
from caster.cli.installation import Finding, Package, find_package
from mitsuba_ref.cli import doctor as judge_doctor

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
NAMED = {finding.name: finding for finding in installation.report()}


def ask(program: str) -> dict[str, Finding]:
    """The judge's findings when Mitsuba's description comes from `program`, Python source."""
    return {finding.name: finding for finding in judge_doctor.judge_findings([sys.executable, "-c", program])}


def describe(**answer: object) -> dict[str, Finding]:
    return ask(f"print({json.dumps(json.dumps(answer))})")


def test_every_dependency_is_looked_for_with_its_least_version():
    least = {part.distribution: part.least for part in installation.PACKAGES}
    assert least == dict(re.split(">=", dependency) for dependency in PROJECT["dependencies"])


def test_the_judges_pins_are_the_projects():
    pins = [f"{name}=={version}" for name, version in judge_doctor.PINNED.items()]
    assert pins == PROJECT["optional-dependencies"]["reference"]


def test_peers_are_looked_for_with_the_projects_least_versions_and_are_not_needed():
    least = {f"{part.distribution}>={part.least}" for part in judge_doctor.PEERS}
    assert least == set(PROJECT["optional-dependencies"]["peers"])
    assert not any(part.needed for part in judge_doctor.PEERS)


def test_matplotlib_is_looked_for_with_the_projects_least_version_and_is_not_needed():
    (least,) = PROJECT["optional-dependencies"]["plots"]
    assert f"{judge_doctor.MATPLOTLIB.distribution}>={judge_doctor.MATPLOTLIB.least}" == least
    finding = next(each for each in judge_doctor.report() if each.name == "matplotlib")
    assert finding.found and not finding.needed and finding.detail == importlib.metadata.version("matplotlib")
    assert "make stress" in finding.adds


def test_a_judge_without_matplotlib_is_usable_and_states_what_it_would_add(monkeypatch):
    monkeypatch.setattr(judge_doctor, "MATPLOTLIB", judge_doctor.MATPLOTLIB._replace(distribution="no-such-matplotlib"))
    finding = describe(variants=["scalar_rgb"])["no-such-matplotlib"]
    assert not finding.found and finding.detail == "not installed" and finding.way_out.startswith("pip install")
    assert judge_doctor.exit_code([finding]) == 0
    assert "would add the plots" in installation.format_table([finding])


def test_this_environment_is_usable():
    assert installation.exit_code(list(NAMED.values())) == 0, installation.format_table(list(NAMED.values()))


def test_a_package_that_is_not_installed_has_a_way_out():
    finding = find_package(Package("no-such-package-anywhere", "nothing", "1.2", "wings"))
    assert not finding.found and finding.detail == "not installed"
    assert finding.way_out == "pip install 'no-such-package-anywhere>=1.2'"


def test_a_package_that_is_too_old_is_not_found():
    finding = find_package(Package("numpy", "numpy", "999.0", "arrays"))
    assert not finding.found and "too old, 999.0 or newer is needed" in finding.detail


def test_versions_are_compared_as_numbers():
    assert find_package(Package("OpenEXR", "OpenEXR", "3.4.9", "images")).found
    assert installation._numbers("3.4.10") > installation._numbers("3.4.9")


def test_a_package_that_does_not_import_is_not_found():
    finding = find_package(Package("numpy", "no_such_module", "1.0", "arrays"))
    assert not finding.found and "does not import: No module named 'no_such_module'" in finding.detail


def test_a_compiler_that_is_switched_off_is_stated(monkeypatch):
    monkeypatch.setenv("CASTER_JIT", "0")
    (numba,) = (find_package(part) for part in installation.PACKAGES if part.module == "numba")
    assert numba.found and numba.detail.endswith("switched off by CASTER_JIT=0")


@pytest.mark.parametrize(("needed", "code", "verdict"), [(True, 4, "Not usable"), (False, 0, "Usable")])
def test_only_something_needed_makes_the_machine_unusable(needed, code, verdict):
    missing = Finding("wings", False, needed, "not installed", "flight", "grow them")
    findings = [NAMED["Python"], missing]
    assert installation.exit_code(findings) == code
    *_, line, _, last = installation.format_table(findings).splitlines()
    assert "wings" in line and line.endswith(f"{'needed for' if needed else 'would add'} flight (grow them)")
    assert last.startswith(verdict)


def test_a_program_can_read_the_findings():
    answer = json.loads(installation.format_json(list(NAMED.values())))
    assert answer["usable"] is True
    assert [Finding(**finding) for finding in answer["findings"]] == list(NAMED.values())


def test_the_judge_looks_for_everything_the_caster_uses_and_for_mitsuba():
    names = [finding.name for finding in judge_doctor.report()]
    assert names[: len(NAMED)] == list(NAMED)
    assert {"mitsuba", "drjit", "variants", "libLLVM"} <= set(names)


def test_mitsuba_answers_requests():
    variants = next(finding for finding in judge_doctor.report() if finding.name == "variants")
    assert variants.found and "scalar_rgb" in variants.detail, variants.detail


def test_the_judge_is_usable_without_libllvm_a_gpu_and_a_browser():
    found = describe(variants=["scalar_rgb"], libllvm=None)
    assert found["variants"].detail == "scalar_rgb"
    assert not found["libLLVM"].found and found["libLLVM"].way_out == "apt install libllvm19"
    assert not any(found[name].needed for name in ("libLLVM", "GPU", "browser"))
    assert judge_doctor.usable([found["variants"], found["libLLVM"]])


def test_the_libllvm_in_use_is_named():
    found = describe(variants=["scalar_rgb", "llvm_ad_rgb"], libllvm="/usr/lib/libLLVM.so.19.1")
    assert found["libLLVM"].found and found["libLLVM"].detail == "/usr/lib/libLLVM.so.19.1"


def test_no_working_variant_makes_the_judge_unusable():
    found = describe(variants=[], libllvm=None, why="scalar_rgb: wrong answer: t [7.0, inf]")
    assert found["variants"].needed and not found["variants"].found
    assert found["variants"].detail.endswith("no variant of it works; scalar_rgb: wrong answer: t [7.0, inf]")


def test_the_llvm_variant_alone_is_not_enough():
    """Spheres, disks and cylinders need the scalar one."""
    found = describe(variants=["llvm_ad_rgb"], libllvm="/usr/lib/libLLVM.so.19.1", why="scalar_rgb: abort (SIGABRT)")
    assert not found["variants"].found and found["variants"].detail == "llvm_ad_rgb; scalar_rgb: abort (SIGABRT)"


def test_a_libllvm_that_does_not_work_is_named_with_its_reason():
    found = describe(variants=["scalar_rgb"], libllvm=None, why="/usr/lib/libLLVM-15.so.1: abort (SIGABRT)")
    assert found["variants"].found and found["variants"].detail == "scalar_rgb"
    assert found["libLLVM"].detail.endswith("works with: /usr/lib/libLLVM-15.so.1: abort (SIGABRT)")


@pytest.mark.parametrize(
    ("program", "says"),
    [
        ("import os; os.abort()", "ended with SIGABRT"),
        ("import os; os.kill(os.getpid(), 11)", "ended with SIGSEGV"),
        ("raise ImportError('libdrjit-core.so: cannot open')", "exit code 1: ImportError: libdrjit-core.so"),
        ("print('Warning: no answer')", "not a description: 'Warning: no answer'"),
        ("print(7)", "not a description: '7'"),
        ("", "not a description: ''"),
    ],
)
def test_a_mitsuba_that_dies_or_babbles_is_a_finding(program, says):
    variants = ask(program)["variants"]
    assert not variants.found and says in variants.detail
    assert judge_doctor.exit_code([variants]) == 4


def test_a_mitsuba_that_hangs_is_a_finding(monkeypatch):
    monkeypatch.setattr(judge_doctor, "PROBE_TIMEOUT_SECONDS", 0.5)
    assert ask("import time; time.sleep(60)")["variants"].detail == "no answer within 0.5 s"


def test_another_mitsuba_is_used_but_stated_and_another_drjit_is_refused(monkeypatch):
    monkeypatch.setattr(judge_doctor, "PINNED", {"mitsuba": "3.9.9", "drjit": "1.5.9"})
    found = describe(variants=["scalar_rgb"])
    assert found["mitsuba"].found and found["mitsuba"].detail.endswith("the bounds belong to 3.9.9")
    assert not found["drjit"].found
    assert found["variants"].detail == "needs drjit first"
