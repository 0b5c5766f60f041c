"""Properties of the machine and of the software that run times depend on."""

import os
import platform

from caster import __version__
from caster.rendering.threads import core_count
from mitsuba_ref.reference.store import machine
from mitsuba_ref.reference.subprocess_runner import PACKAGE_PARENT
from mitsuba_ref.report.html_report import commit
from mitsuba_ref.report.output import libllvm

LOAD, CORES, REVISION = "load before", "processors used", "revision"


def machine_properties() -> dict[str, str]:
    return {
        **machine(),
        CORES: f"{core_count()} of {os.cpu_count() or 1}",
        "kernel": platform.release(),
        LOAD: f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown",
        "caster": __version__,
        REVISION: commit(str(PACKAGE_PARENT)) or "unknown",
        "libLLVM": libllvm(),
    }
