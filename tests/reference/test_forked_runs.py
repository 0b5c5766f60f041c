"""A fork says what a process of its own says, of its own tree, and Mitsuba is asked anew about anything new."""

import re
from dataclasses import replace

import numpy as np
import pytest
from edited_tree import Forks, copy_tree, edit, run
from forked_runs import everything_given
from mitsuba_scenes import job, shape, write

SCENE = ("validate", "scenes/one-sphere.toml", "--size", "7", "6", "-j", "1")
TIMES = re.compile(r" *\d+\.\d(?= s\b|$| \d+ [a-z])", re.MULTILINE)


def said(found):
    """All that a command leaves, but for the seconds that it took."""
    return found.returncode, TIMES.sub("", found.stdout), found.stderr


@pytest.fixture
def memory(tmp_path):
    folder = tmp_path / "answers"
    folder.mkdir()
    return folder


@pytest.fixture(params=[False, True], ids=["each loads its tree", "the unedited tree is loaded"])
def forks(request, tmp_path, memory, unedited):
    forks = Forks(tmp_path, memory, home=unedited if request.param else None)
    yield forks
    forks.close()


@pytest.fixture(scope="module")
def alone(unedited, tmp_path_factory):
    """What processes of their own state of the unedited tree and of a wrong one, by tree."""
    wrong = copy_tree(tmp_path_factory.mktemp("wrong"), unedited)
    edit(
        wrong, "caster/kernels/surface/lighting.py", "albedo[0] / math.pi * irradiance[0]", "albedo[0] * irradiance[0]"
    )
    return {tree: run(tree, *SCENE) for tree in (unedited, wrong)}


@pytest.mark.slow("a test of tests: judges four times in processes of their own")
def test_a_fork_states_what_a_process_states_of_a_right_tree_and_of_a_wrong_one(forks, memory, alone):
    codes = []
    unedited, wrong = alone
    for tree in (unedited, wrong, unedited):  # the third is what a fork of before may not have altered
        forked = forks.run(tree, *SCENE)
        assert said(forked) == said(alone[tree])
        codes.append(forked.returncode)
    assert codes == [0, 1, 0] and len(list(memory.iterdir())) == 1  # the fault alters nothing that Mitsuba is given


@pytest.mark.slow("a test of tests: some processes of their own")
def test_bad_usage_and_what_is_no_module_end_as_in_a_process(forks, unedited):
    for words, module in (
        (("validate", "--nonsense"), "mitsuba_ref"),
        (("render", "none.toml"), "caster"),
        ((), "nothing"),
    ):
        alone, forked = run(unedited, *words, module=module), forks.run(unedited, *words, module=module)
        assert forked.returncode == alone.returncode > 0 and forked.stdout == alone.stdout == ""
        assert forked.stderr.splitlines()[-1].split()[-3:] == alone.stderr.splitlines()[-1].split()[-3:]


def test_whatever_mitsuba_is_given_counts(tmp_path):
    xml = write(tmp_path, shape("sphere", "ball", 0))
    (tmp_path / "meshes").mkdir()
    mesh = tmp_path / "meshes" / "some.ply"
    mesh.write_bytes(b"ply")
    first = job(xml, "scalar_rgb", [[0, 0, 5]], [[0, 0, -1]])
    ray = np.nextafter(first.o, np.float32(9))
    others = (replace(first, o=ray), replace(first, d=-first.d), replace(first, t_max=first.o[:, 2]))
    others += (replace(first, variant="llvm_ad_rgb"), replace(first, lights=False), replace(first, sensor=True))
    told = [everything_given(first, {}), everything_given(first, {"LIBRARY": "x"})]
    told += [everything_given(other, {}) for other in others]
    mesh.write_bytes(b"ply ")
    told.append(everything_given(first, {}))
    mesh.write_bytes(b"ply")
    write(tmp_path, shape("sphere", "ball", 1))
    told.append(everything_given(first, {}))
    assert len(set(told)) == len(told) == 10
    write(tmp_path, shape("sphere", "ball", 0))
    assert everything_given(first, {}) == told[0]
