"""Mitsuba limited to older instruction sets, on any x86-64 machine: scenes and tests under each of them.

python -m isa_runs [ISA ...] [--jobs N]

Mitsuba computes t and normals by approximate reciprocals, whose bits depend on the instruction set: what holds under
one may fail under another. The library isa_limit.c, preloaded, limits Embree and Dr.Jit's LLVM backend.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mitsuba_ref.reference import variants

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
LIMITED = ("sse4.2", "avx", "avx2")
NATIVE = "native"  # all that the CPU has
# What pytest is called with: planted faults show in numbers, not bits, and most slow tests repeat what others find.
TESTS = {
    "tests": ("-m", "not slow", "tests/reference", "tests/exact", "--ignore-glob=*_faults.py"),
    "slow tests": (
        "-m",
        "slow",
        "tests/reference/test_adjudication.py",
        "tests/reference/test_bands.py",
        "tests/reference/test_detection_power.py",
        "tests/reference/test_excused_classes.py",
        "tests/reference/test_ray_lists.py",
    ),
}
# Which pixels Mitsuba disputes, by rounding or at a tie, belongs to the instruction set; no verdict on ours does.
MAY_DIFFER = ("agree", "explained", "tie", "out_of_domain")

# Rays to a square, whose t show the operations, or how many LLVM code takes at once. Embree prints what it uses.
SCALAR_PROBE = """
import random
import mitsuba as mi
mi.set_variant("scalar_rgb")
tilt = mi.ScalarTransform4f().rotate([1, 2, 3], 40).scale(9)  # along the axes there would be little to fuse
scene = mi.load_dict({"type": "scene", "square": {"type": "rectangle", "to_world": tilt}})
random.seed(0)
rays = [[random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), random.uniform(8, 16)] for _ in range(200)]
print("found", *(float(scene.ray_intersect(mi.Ray3f(o, [0.05, 0.03, -1])).t).hex() for o in rays))
"""
LLVM_PROBE = """
import ctypes, pathlib
import mitsuba as mi, drjit
mi.set_variant("llvm_ad_rgb")
mi.load_dict({"type": "scene", "square": {"type": "rectangle"}})
core = next(pathlib.Path(drjit.__file__).parent.glob("libdrjit-core.*"))
print("found", ctypes.CDLL(str(core))._Z21jit_llvm_vector_widthv())
"""
LLVM_WIDTH = "8"  # of x86-64-v3, which isa_limit.c sets


class LimitError(Exception):
    """Why Mitsuba cannot be limited here, or was not."""


@dataclass(frozen=True)
class Limit:
    """An instruction set, and the environment that keeps Mitsuba from using a newer one."""

    isa: str
    library: Path
    log: Path

    @property
    def environment(self) -> dict[str, str]:
        preloaded = ":".join(filter(None, [str(self.library), os.environ.get("LD_PRELOAD")]))
        return {
            "LD_PRELOAD": preloaded,
            "ISA_LIMIT": "" if self.isa == NATIVE else self.isa,
            "ISA_LIMIT_LOG": str(self.log),
            "MITSUBA_REF_STORE": "off",  # an answer of another instruction set is none of this one
        }

    def run(self, command: Sequence[str | Path], **more: str) -> subprocess.CompletedProcess[str]:
        """Run a command of this tree under the limit. Raises LimitError if it made no Embree device."""
        self.log.write_text("")
        environment = {**os.environ, **self.environment, **more}
        done = subprocess.run(
            command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        if not self.log.read_text():
            raise LimitError(f"{self.isa}: no Embree device was made by {' '.join(map(str, command))}:\n{done.stdout}")
        return done


def available() -> tuple[str, ...]:
    """Instruction sets that Embree can be limited to on this CPU."""
    try:
        flags = Path("/proc/cpuinfo").read_text().split()
    except OSError:
        return ()
    return tuple(isa for isa in LIMITED if isa.replace(".", "_") in flags)


@contextmanager
def limits(isas: Sequence[str]) -> Iterator[dict[str, Limit]]:
    """Limits by instruction set, each seen to work. Raises LimitError."""
    with tempfile.TemporaryDirectory() as name:
        library = compiled(Path(name))
        found = {isa: Limit(isa, library, Path(name) / f"{isa}.log") for isa in isas}
        check_limits(found)
        yield found


def compiled(folder: Path) -> Path:
    """The library that is preloaded. Raises LimitError where there is no C compiler."""
    cc, library = shutil.which("cc"), folder / "isa_limit.so"
    if cc is None:
        raise LimitError("no C compiler: cc; on Debian and Ubuntu: apt install gcc libc6-dev")
    command = [cc, "-shared", "-fPIC", "-O2", "-Wall", "-Werror", HERE / "isa_limit.c", "-o", library, "-ldl"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise LimitError(f"{HERE / 'isa_limit.c'} does not compile:\n{done.stderr}")
    return library


def check_limits(found: Mapping[str, Limit]) -> None:
    """Raise LimitError unless Mitsuba shows each limit: in Embree's words, in LLVM's width, and in the bits of t."""
    bits = {}
    for isa, limit in found.items():
        stated, bits[isa] = observed(limit, SCALAR_PROBE)
        if isa != NATIVE and stated.lower() != isa:
            raise LimitError(f"{isa}: Embree says that it uses {stated}")
        if isa != NATIVE and variants.usable_variants().libllvm:
            _, width = observed(limit, LLVM_PROBE, **variants.environment_for(variants.LLVM))
            if width != LLVM_WIDTH:
                raise LimitError(f"{isa}: LLVM code takes {width} rays at once, expected {LLVM_WIDTH}")
    for isa in ("sse4.2", "avx"):
        if isa in bits and bits[isa] == bits.get("avx2"):
            raise LimitError(
                f"{isa}: each t has the bits that it has under avx2, which fuses operations as {isa} cannot"
            )


def observed(limit: Limit, probe: str, **more: str) -> tuple[str, str]:
    """What Embree uses by its own words, and what a probe found."""
    done = limit.run([sys.executable, "-c", probe], ISA_LIMIT_VERBOSE="1", **more)
    lines = done.stdout.splitlines()
    targets = [line.partition("(supported)")[0].split() for line in lines if "(supported)" in line]
    values = [line.removeprefix("found ") for line in lines if line.startswith("found ")]
    if done.returncode or len(targets) != 1 or len(values) != 1:
        raise LimitError(
            f"{limit.isa}: Embree does not state what it uses (exit code {done.returncode}):\n{done.stdout}"
        )
    return targets[0][-1], values[0]


def validate(limit: Limit, scenes: str, out: Path, *options: str) -> tuple[bool, str, dict[str, dict[str, int]]]:
    """Whether `validate` passes, what it prints, and the pixels of each class of each scene."""
    out.unlink(missing_ok=True)
    command = [sys.executable, "-m", "mitsuba_ref", "validate", scenes, "--json", str(out), *options]
    done = limit.run(command)
    scenes_of = json.loads(out.read_text())["scenes"] if out.exists() else []
    return done.returncode == 0, done.stdout, {scene["name"]: scene["counts"] for scene in scenes_of}


def count_differences(
    before: dict[str, dict[str, int]], after: dict[str, dict[str, int]]
) -> Iterator[tuple[str, bool]]:
    """Differences between the counts of two runs, in words, and whether the instruction set may make them."""
    for scene in before.keys() | after.keys():
        first, second = before.get(scene, {}), after.get(scene, {})
        changed = [name for name in first.keys() | second.keys() if first.get(name) != second.get(name)]
        if changed:
            words = ", ".join(f"{first.get(name)} -> {second.get(name)} {name}" for name in sorted(changed))
            yield f"{scene}: {words}", set(changed) <= set(MAY_DIFFER)


def main(arguments: Sequence[str]) -> int:
    """Scenes and tests under each instruction set; 0 all pass, 1 not, 4 where Embree cannot be limited."""
    parser = argparse.ArgumentParser(
        prog="isa_runs", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "isas", metavar="ISA", nargs="*", help=f"of {', '.join((*LIMITED, NATIVE))}; default: all of this CPU"
    )
    parser.add_argument("--jobs", metavar="N", default="auto", help="processes of the tests")
    args = parser.parse_args(arguments)
    if unknown := set(args.isas) - {*LIMITED, NATIVE}:
        parser.error(f"expected {', '.join((*LIMITED, NATIVE))}, got {', '.join(sorted(unknown))}")
    out = ROOT / "build" / "isa"
    out.mkdir(parents=True, exist_ok=True)
    try:
        with limits(args.isas or (*available(), NATIVE)) as found:
            return run_all(found, out, args.jobs)
    except LimitError as problem:
        print(f"isa_runs: {problem}", file=sys.stderr)
        return 4


def run_all(found: Mapping[str, Limit], out: Path, jobs: str) -> int:
    """Print a line for each run; outputs of the runs are files in `out`."""
    passed, counts = True, {}
    for isa, limit in found.items():
        ok, text, counts[isa] = validate(limit, "scenes", out / f"{isa}.json")
        passed &= report(isa, "validate scenes", ok, text, out)
        for what, arguments in TESTS.items():
            done = limit.run([sys.executable, "-m", "pytest", "-n", jobs, "--dist", "worksteal", *arguments])
            passed &= report(isa, what, done.returncode == 0, done.stdout, out)
    first, *others = counts
    for isa in others:
        for words, allowed in sorted(count_differences(counts[first], counts[isa])):
            passed &= allowed
            print(f"{'differs' if allowed else 'FAIL   '}  {first} -> {isa}: {words}")
    return 0 if passed else 1


def report(isa: str, what: str, ok: bool, text: str, out: Path) -> bool:
    """Print the outcome of a run, and its output if it fails."""
    (out / f"{isa} {what}.txt").write_text(text)
    print(f"{'PASS' if ok else 'FAIL'}  {isa:<8}{what}", flush=True)
    if not ok:
        print(text, flush=True)
    return ok


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
