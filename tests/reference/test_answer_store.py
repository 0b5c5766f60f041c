"""The store of Mitsuba's answers: the very same request is not asked twice; anything else, and anything damaged, is."""

import json
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mitsuba_scenes import job, shape, write

from caster.system import processor
from mitsuba_ref.__main__ import main
from mitsuba_ref.cli.doctor import answer_store as finding
from mitsuba_ref.reference import answer_store, mitsuba_process, variants
from mitsuba_ref.reference.answer_store import StoreFolder, local_store, request_key, stored_response
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse

ROOT = Path(__file__).resolve().parents[2]
RAYS = 3
SHIPPED = str(ROOT / "scenes" / "one-sphere.toml")


def response_of(request: TraceRequest) -> TraceResponse:
    """Of a scene that nothing of is hit, but for the first ray."""
    rows = {name: np.zeros((len(request.o), *row), kind) for name, (row, kind) in TraceResponse.ROWS.items()}
    rows["t"][1:], rows["shape"][1:], rows["prim"][1:] = np.inf, -1, -1
    rows["t"][:1] = 4.0
    light = {"light_rgb": np.zeros((0, RAYS, 3), np.float32), "light_visible": np.zeros((0, RAYS), bool)}
    sensor = dict.fromkeys(("sensor_o", "sensor_d", "sensor_t_max"))
    return TraceResponse(**rows, **light, **sensor, names=["ball"], versions={"mitsuba": "3"}, seconds=1.5)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """The store of this test."""
    monkeypatch.setenv(answer_store.STORE_VARIABLE, str(tmp_path / "store"))
    return tmp_path / "store"


@pytest.fixture
def request_(tmp_path) -> TraceRequest:
    folder = tmp_path / "scene"
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes" / "0.ply").write_bytes(b"ply")
    xml = write(folder, shape("sphere", "ball", 0))
    return job(xml, "scalar_rgb", [[0, 0, 5 + i] for i in range(RAYS)], [[0, 0, -1]] * RAYS)


@pytest.fixture
def asked(monkeypatch) -> list[TraceRequest]:
    """Requests that reach Mitsuba, for which a made response stands in."""
    sent: list[TraceRequest] = []

    def send(request, timeout):
        sent.append(request)
        return response_of(request)

    monkeypatch.setattr(mitsuba_process, "send_request", send)
    return sent


def files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


def test_the_same_request_is_requested_once_and_states_it(folder, request_, asked):
    first, second = mitsuba_process.send_stored(request_), mitsuba_process.send_stored(request_)
    assert len(asked) == 1
    assert not first.stored and first.seconds == 1.5
    assert second.stored and second.seconds == 0.0
    for name in TraceResponse.ROWS:
        one, other = getattr(first, name), getattr(second, name)
        assert one.dtype == other.dtype and one.tobytes() == other.tobytes()
    assert (first.names, first.versions, second.sensor_o) == (second.names, second.versions, None)


def test_the_key_does_not_depend_on_where_the_scene_lies(request_, tmp_path):
    moved = (tmp_path / "scene").rename(tmp_path / "elsewhere")
    before = request_key(replace(request_, xml=moved / request_.xml.name))
    again = moved.rename(tmp_path / "scene")
    assert before == request_key(replace(request_, xml=again / request_.xml.name)) != ""


def other_rays(request, patch):
    return replace(request, o=np.nextafter(request.o, np.float32(9)))


def other_scene(request, patch):
    write(request.xml.parent, shape("sphere", "ball", 1))
    return request


def other_mesh(request, patch):
    (request.xml.parent / "meshes" / "0.ply").write_bytes(b"plz")
    return request


def other_file(request, patch):
    (request.xml.parent / "meshes" / "1.ply").write_bytes(b"")
    return request


def other_name(request, patch):
    (request.xml.parent / "meshes" / "0.ply").rename(request.xml.parent / "meshes" / "1.ply")
    return request


def other_library(request, patch):
    patch.setattr(variants, "environment_for", lambda _: {"DRJIT_LIBLLVM_PATH": "/libLLVM.so.99"})
    return request


def other_source(request, patch):
    """An edit of the child's side."""
    copy = request.xml.parent.parent / "mitsuba_calls.py"
    copy.write_text(answer_store.SOURCES[0].read_text() + "\n# edited\n")
    patch.setattr(answer_store, "SOURCES", (copy, *answer_store.SOURCES[1:]))
    answer_store.request_dependencies.cache_clear()
    return request


def other_version_of(name):
    def changed(request, patch):
        usual = variants.installed_version
        patch.setattr(variants, "installed_version", lambda of: "9" if of == name else usual(of))
        answer_store.request_dependencies.cache_clear()
        return request

    return changed


def other_processor(request, patch):
    patch.setattr(processor, "description", lambda: "GenuineIntel family 6 model 142 (x86-64-v3)")
    answer_store.request_dependencies.cache_clear()
    return request


CHANGES = {
    "ray": other_rays,
    "direction": lambda request, patch: replace(request, d=-request.d),
    "t_max": lambda request, patch: replace(request, t_max=request.o[:, 2]),
    "one ray less": lambda request, patch: replace(
        request, o=request.o[:-1], d=request.d[:-1], t_max=request.t_max[:-1]
    ),
    "variant": lambda request, patch: replace(request, variant="llvm_ad_rgb"),
    "lights": lambda request, patch: replace(request, lights=not request.lights),
    "sensor": lambda request, patch: replace(request, sensor=not request.sensor),
    "strict": lambda request, patch: replace(request, strict=not request.strict),
    "XML": other_scene,
    "mesh": other_mesh,
    "a mesh more": other_file,
    "name of a mesh": other_name,
    "mesh file": lambda request, patch: replace(request, mesh_files=(request.xml,)),
    "libLLVM": other_library,
    "source": other_source,
    "processor": other_processor,
    "Mitsuba": other_version_of("mitsuba"),
    "Dr.Jit": other_version_of("drjit"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_whatever_changes_is_requested_again(request_, monkeypatch, change):
    before = request_key(request_)
    with monkeypatch.context() as patch:
        changed = request_key(CHANGES[change](request_, patch))
    answer_store.request_dependencies.cache_clear()
    assert changed != before and changed


def test_a_mesh_file_counts_by_its_bytes_and_its_name(request_, tmp_path):
    """Mitsuba reads it by itself, whatever the exported scene has of it."""
    keys = set()
    for name, content in (("a.obj", b"v 0 0 0"), ("a.obj", b"v 0 0 1"), ("b.obj", b"v 0 0 1")):
        (tmp_path / name).write_bytes(content)
        keys.add(request_key(replace(request_, mesh_files=(tmp_path / name,))))
    assert len(keys) == 3


def test_scenes_that_are_requested_together_have_keys_of_their_own(request_, tmp_path):
    (tmp_path / "more").mkdir()
    second = replace(request_, xml=write(tmp_path / "more", shape("sphere", "egg", 0)), lights=False)
    first = replace(request_, lights=False)
    orders = [mitsuba_process.merge_requests(each) for each in ([first, second], [second, first], [first, first])]
    shifted = replace(orders[0], more=((second.xml, RAYS - 1),))
    assert len({request_key(each) for each in (first, second, *orders, shifted)}) == 6


@pytest.mark.parametrize("value", ["/etc/bumps.png", "../bumps.png", "~/bumps.png", "C:\\bumps.png"])
def test_a_scene_that_names_files_elsewhere_is_never_stored(folder, request_, asked, value):
    write(request_.xml.parent, f'<string name="filename" value="{value}"/>')
    assert request_key(request_) == ""
    assert not any(mitsuba_process.send_stored(request_).stored for _ in range(2)) and len(asked) == 2


DAMAGES = {
    "a flipped bit in the middle": lambda data: (
        data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :]
    ),
    "a flipped bit in the digest": lambda data: bytes([data[0] ^ 1]) + data[1:],
    "cut short": lambda data: data[:-1],
    "a byte more": lambda data: data + b"\0",
    "empty": lambda data: b"",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_answer_is_requested_again_and_replaced(folder, request_, asked, damage):
    mitsuba_process.send_stored(request_)
    (file,) = files(folder)
    whole = file.read_bytes()
    file.write_bytes(DAMAGES[damage](whole))
    assert not mitsuba_process.send_stored(request_).stored and len(asked) == 2
    assert file.read_bytes() == whole and mitsuba_process.send_stored(request_).stored


def test_an_answer_under_the_name_of_another_is_requested_again(folder, request_, asked):
    other = other_rays(request_, None)
    mitsuba_process.send_stored(request_)
    (file,) = files(folder)
    (folder / f"{request_key(other)}{answer_store.SUFFIX}").write_bytes(file.read_bytes())
    assert not mitsuba_process.send_stored(other).stored and len(asked) == 2


def test_an_answer_to_other_rays_or_of_another_shape_is_requested_again(folder, request_, asked):
    """Whole by its digest, as a faulty store of several machines may hand it over."""
    store, key = local_store(), request_key(request_)
    contents = (
        response_of(request_).to_bytes(),
        b"",
        b"{}\n",
        b"null\nPK",
        replace(response_of(request_), names=[]).to_bytes(),
    )
    for content, rays in zip(contents, (RAYS + 1, RAYS, RAYS, RAYS, RAYS), strict=True):
        store.put(key, content)
        assert stored_response(store, key, rays) is None
    assert not mitsuba_process.send_stored(request_).stored and len(asked) == 1


@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_or_file_that_others_may_write_is_not_used(folder, request_, asked, mode):
    mitsuba_process.send_stored(request_)
    (file,) = files(folder)
    file.chmod(mode)
    assert not mitsuba_process.send_stored(request_).stored
    folder.chmod(mode)
    assert not mitsuba_process.send_stored(request_).stored and len(asked) == 3
    found = finding()
    assert not found.found and "other users may write it" in found.detail


def test_crashes_are_not_kept(folder, request_, monkeypatch):
    crash = Crash("abort", "", "SIGABRT", 0.1)
    monkeypatch.setattr(mitsuba_process, "send_request", lambda *_: crash)
    assert mitsuba_process.send_stored(request_) is crash and not folder.exists()


def test_the_least_recently_used_make_room(tmp_path):
    store = StoreFolder(tmp_path / "store", 1000)
    for i, key in enumerate("abc"):
        store.put(key, bytes(250))
        os.utime(store.folder / f"{key}.answer", (i, i))
    assert store.use().answers == 3 and store.use().size < 1000
    assert store.get("a") == bytes(250)  # used now, so b is the oldest
    store.put("d", bytes(250))
    assert [store.get(key) is not None for key in "abcd"] == [True, False, True, True]
    store.put("e", bytes(1000))  # more than there is room for, whatever goes
    assert store.get("e") is None and store.use().answers == 3


def test_a_folder_that_cannot_be_written_costs_time_only(tmp_path, monkeypatch, request_, asked):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(answer_store.STORE_VARIABLE, str(tmp_path / "file" / "store"))
    assert not any(mitsuba_process.send_stored(request_).stored for _ in range(2)) and len(asked) == 2


def test_settings(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv(answer_store.LIMIT_VARIABLE, "7")
    monkeypatch.delenv(answer_store.STORE_VARIABLE)
    store = local_store()
    assert (store.folder, store.limit) == (tmp_path / "caster" / "answers", 7 * 10**6)
    store.put("a", bytes(10**6))
    found = finding()
    assert found.found and not found.needed and "1 answers of Mitsuba, 1 of 7 MB" in found.detail
    monkeypatch.setenv(answer_store.STORE_VARIABLE, "off")
    assert local_store() is None and "off" in finding().detail


def judged(tmp_path, capsys, *words: str) -> tuple[dict, str]:
    """Of the command: verdict.json without times, and what it prints."""
    file = tmp_path / "v.json"
    code = main(["validate", SHIPPED, "--size", "24", "20", "-j", "1", "--json", str(file), *words])
    assert code == 0
    record = json.loads(file.read_text())
    (scene,) = record["scenes"]
    for name in ("seconds", "reference_seconds", "exact_seconds"):
        del scene[name]
    return record, capsys.readouterr().out


def test_validate_states_what_came_from_the_store_and_the_verdict_is_the_same(folder, tmp_path, capsys):
    fresh, text = judged(tmp_path, capsys)
    assert fresh["references_stored"] == 0 and "store" not in text
    stored, text = judged(tmp_path, capsys)
    assert stored["references_stored"] == 1 and stored["scenes"][0]["reference_stored"]
    assert "reference:  1 of 1 scenes: answered in earlier runs, taken from the store" in text
    stored["references_stored"], stored["scenes"][0]["reference_stored"] = 0, False
    assert stored == fresh
    again, _ = judged(tmp_path, capsys, "--no-store")
    assert again == fresh


def test_a_changed_caster_is_judged_by_stored_answers(folder, tmp_path, capsys, monkeypatch):
    """Which is what the store is for; and its error is found by them."""
    judged(tmp_path, capsys)
    from mitsuba_ref.subjects.subject import OurCaster

    usual = OurCaster.answer

    def wrong(self, *args, **options):
        answer = usual(self, *args, **options)
        return replace(answer, t=answer.t * (1.0 + 2.0**-12))

    monkeypatch.setattr(OurCaster, "answer", wrong)
    file = tmp_path / "v.json"
    assert main(["validate", SHIPPED, "--size", "24", "20", "-j", "1", "--json", str(file)]) == 1
    assert json.loads(file.read_text())["references_stored"] == 1


def test_two_processes_may_keep_the_same_answer_at_the_same_time(tmp_path):
    store, content = StoreFolder(tmp_path / "store", 10**8), bytes(10**6)
    children = []
    for _ in range(2):
        child = os.fork()
        if child == 0:
            for _ in range(20):
                store.put("a", content)
            os._exit(0)
        children.append(child)
    deadline = time.monotonic() + 60
    seen = set()
    while store.get("a") is None and time.monotonic() < deadline:
        time.sleep(0.001)
    for _ in range(50):
        seen.add(store.get("a"))
    for child in children:
        assert os.waitpid(child, 0)[1] == 0
    assert seen == {content} and store.use().answers == 1
