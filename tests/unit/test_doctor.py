"""The doctor names each missing package, its use and the way to install it, and survives broken ones."""

import json
import re

import pytest
from places import PYPROJECT

from caster.cli import installation
from caster.cli.installation import Finding, Package, find_package
from mitsuba_ref.cli import doctor as judge_doctor
from mitsuba_ref.reference.variants import Variants

PROJECT = PYPROJECT["project"]
NAMED = {finding.name: finding for finding in installation.report()}


def with_variants(monkeypatch, scalar=True, libllvm=None, why="") -> dict[str, Finding]:
    """The judge's findings where Mitsuba's variants are so."""
    monkeypatch.setattr(judge_doctor, "usable_variants", lambda: Variants(scalar, libllvm, why))
    return {finding.name: finding for finding in judge_doctor.judge_findings()}


def test_every_dependency_is_looked_for_with_its_least_version():
    least = {part.distribution: part.least for part in installation.PACKAGES}
    assert least == dict(re.split(">=", dependency) for dependency in PROJECT["dependencies"])


def test_the_judges_pins_are_the_projects():
    pins = [f"{name}=={version}" for name, version in judge_doctor.PINNED.items()]
    assert pins == PROJECT["optional-dependencies"]["reference"]


def test_this_environment_is_usable(capsys):
    assert installation.print_findings(list(NAMED.values()), False) == 0
    assert capsys.readouterr().out.endswith("Usable: everything needed was found.\n")


@pytest.mark.parametrize(
    ("package", "says"),
    [
        (("no-such-package-anywhere", "nothing", "1.2"), "not installed"),
        (("numpy", "numpy", "999.0"), "too old, 999.0 or newer is needed"),
        (("numpy", "no_such_module", "1.0"), "does not import: No module named 'no_such_module'"),
    ],
)
def test_a_package_that_cannot_be_used_is_not_found_and_has_a_way_out(package, says):
    finding = find_package(Package(*package, "wings"))
    assert not finding.found and finding.detail.endswith(says)
    assert finding.way_out == f"pip install '{package[0]}>={package[2]}'"


def test_versions_are_compared_by_their_numbers():
    assert find_package(Package("OpenEXR", "OpenEXR", "3.4.9", "images")).found  # not as text: 3.4.10 is newer


@pytest.mark.parametrize(("needed", "code", "verdict"), [(True, 4, "Not usable"), (False, 0, "Usable")])
def test_only_something_needed_makes_the_machine_unusable(capsys, needed, code, verdict):
    missing = Finding("wings", False, needed, "not installed", "flight", "grow them")
    findings = [NAMED["Python"], missing]
    assert installation.print_findings(findings, False) == code
    *_, line, _, last = capsys.readouterr().out.splitlines()
    assert "wings" in line and line.endswith(f"{'needed for' if needed else 'would add'} flight (grow them)")
    assert last.startswith(verdict)
    assert installation.print_findings(findings, True) == code
    answer = json.loads(capsys.readouterr().out)
    assert answer["usable"] is not needed and [Finding(**each) for each in answer["findings"]] == findings


def test_the_judge_looks_for_everything_the_caster_uses_and_for_mitsuba():
    assert {"mitsuba", "drjit", "variants", "libLLVM"} <= {each.name for each in judge_doctor.judge_findings()}


@pytest.mark.parametrize(
    ("found", "variants", "libllvm"),
    [
        ({}, "scalar_rgb", "none that Mitsuba's LLVM variant works with"),
        ({"libllvm": "/lib/libLLVM.so.19.1"}, "scalar_rgb, llvm_ad_rgb", "/lib/libLLVM.so.19.1"),
        ({"scalar": False, "why": "scalar_rgb: wrong"}, "no variant of Mitsuba works; scalar_rgb: wrong", "none that"),
        (
            {"scalar": False, "libllvm": "/lib/libLLVM.so", "why": "scalar_rgb: abort"},
            "llvm_ad_rgb; scalar_rgb: abort",
            "/lib/libLLVM.so",
        ),
        ({"why": "/lib/libLLVM-15.so.1: abort"}, "scalar_rgb", "works with: /lib/libLLVM-15.so.1: abort"),
    ],
)
def test_the_judge_is_usable_with_the_scalar_variant(monkeypatch, found, variants, libllvm):
    """Spheres, disks and cylinders need it; libLLVM is an extra."""
    here = with_variants(monkeypatch, **found)
    assert here["variants"].found is found.get("scalar", True) and here["variants"].detail == variants
    assert here["libLLVM"].found is bool(found.get("libllvm")) and libllvm in here["libLLVM"].detail
    assert not here["libLLVM"].needed
    assert here["variants"].needed


def test_another_mitsuba_is_used_but_stated_and_another_drjit_is_refused(monkeypatch):
    monkeypatch.setattr(judge_doctor, "PINNED", {"mitsuba": "3.9.9", "drjit": "1.5.9"})
    found = with_variants(monkeypatch)
    assert found["mitsuba"].found and found["mitsuba"].detail.endswith("the bounds belong to 3.9.9")
    assert not found["drjit"].found
    assert "variants" not in found, "they need drjit"
