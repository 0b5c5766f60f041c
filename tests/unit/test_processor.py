"""The description of the processor in results."""

import sys

import pytest

from caster.system import processor

V2 = "fpu sse sse2 ssse3 cx16 sse4_1 sse4_2 popcnt lahf_lm"
V3 = f"{V2} avx avx2 fma bmi1 bmi2 f16c movbe abm"


def cpuinfo(flags, vendor="GenuineIntel", model=142):
    """Two processors of one kind, as Linux lists them."""
    lines = ["processor\t: {}", f"vendor_id\t: {vendor}", "cpu family\t: 6", f"model\t\t: {model}"]
    one = "\n".join([*lines, "model name\t: Some CPU: @ 2 GHz", f"flags\t\t: {flags}"])
    return f"{one.format(0)}\n\n{one.format(1)}\n\n"


def test_another_vendor_or_model_is_another_processor():
    """Tables of reciprocals differ between them at the same level."""
    kinds = {
        processor.described(cpuinfo(V3, *which), "x86_64") for which in ((), ("AuthenticAMD",), ("GenuineIntel", 85))
    }
    assert len(kinds) == 3


def test_what_is_not_known_is_said(monkeypatch, tmp_path):
    assert processor.described("", "arm64") == "arm64, unknown model"
    monkeypatch.setattr(processor, "CPUINFO", tmp_path / "none")
    monkeypatch.setattr("platform.processor", lambda: "arm")
    monkeypatch.setattr("platform.machine", lambda: "arm64")
    processor.description.cache_clear()
    found = processor.description()
    processor.description.cache_clear()
    assert found == "arm64, unknown model (arm)"


@pytest.mark.skipif(sys.platform != "linux", reason="others have no /proc/cpuinfo")
def test_this_one_is_known():
    assert "unknown" not in processor.description() and "None" not in processor.description()
