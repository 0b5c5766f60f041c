"""The store: an equal request is answered from it; other requests and damaged responses are sent to Mitsuba."""

import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mitsuba_scenes import job, shape, write

from caster.system import processor
from mitsuba_ref.cli.doctor import kept_results
from mitsuba_ref.reference import mitsuba_process, store, variants
from mitsuba_ref.reference.messages import Crash, TraceRequest, TraceResponse
from mitsuba_ref.reference.mitsuba_process import request_key, send_stored
from mitsuba_ref.reference.store import StoreFolder, key_of, local_store

RAYS = 3


def response_of(request: TraceRequest) -> TraceResponse:
    """A response in which only the first ray hits."""
    more = {name: np.zeros((RAYS, 3), np.float32) for name in ("n", "sh_n", "p", "albedo", "uv", "prim_uv")}
    more |= {name: np.zeros(0, np.float32) for name in ("light_rgb", "light_visible", "sensor", "origin")}
    t, hit = np.array([4.0, np.inf, np.inf], np.float32), np.array([0, -1, -1], np.int32)
    about = {"names": ["ball"], "versions": {"mitsuba": "3"}, "seconds": 1.5, "loaded": ()}
    return TraceResponse(t=t, shape=hit, prim=hit, **more, **about)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """The store of this test."""
    monkeypatch.setenv(store.STORE_VARIABLE, str(tmp_path / "store"))
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
    """Requests that would reach Mitsuba; each gets a prepared response."""
    sent: list[TraceRequest] = []

    def send(request, timeout):
        sent.append(request)
        return response_of(request)

    monkeypatch.setattr(mitsuba_process, "send_request", send)
    return sent


def test_the_same_request_is_requested_once_and_states_it(folder, request_, asked, tmp_path):
    first = send_stored(request_)
    moved = (tmp_path / "scene").rename(tmp_path / "elsewhere")  # where the scene lies does not matter
    second = send_stored(replace(request_, xml=moved / request_.xml.name))
    assert len(asked) == 1
    assert (first.stored, first.seconds, second.stored, second.seconds) == (False, 1.5, True, 0.0)
    for name, one in vars(first).items():
        if isinstance(one, np.ndarray):
            other = getattr(second, name)
            assert one.dtype == other.dtype and one.tobytes() == other.tobytes()
    assert (first.names, first.versions) == (second.names, second.versions)


def file_beside(name: str, content: bytes):
    def change(request, patch):
        (request.xml.parent / "meshes" / name).write_bytes(content)
        return request

    return change


def other_scene(request, patch):
    write(request.xml.parent, shape("sphere", "ball", 1))
    return request


def other_library(request, patch):
    patch.setattr(variants, "environment_for", lambda _: {"DRJIT_LIBLLVM_PATH": "/libLLVM.so.99"})
    return request


def other_source(request, patch):
    """An edit of the child's side."""
    copy = request.xml.parent.parent / "mitsuba_calls.py"
    copy.write_text(mitsuba_process.SOURCES[0].read_text() + "\n# edited\n")
    patch.setattr(mitsuba_process, "SOURCES", (copy, *mitsuba_process.SOURCES[1:]))
    return request


def other_machine(module, name, value):
    def change(request, patch):
        patch.setattr(module, name, value)
        store.this_machine.cache_clear()
        return request

    return change


def replaced(**fields):
    return lambda request, patch: replace(request, **{name: of(request) for name, of in fields.items()})


CHANGES = {
    "rays": replaced(o=lambda r: np.nextafter(r.o, np.float32(9))),
    "variant": replaced(variant=lambda r: "llvm_ad_rgb"),
    "lights": replaced(lights=lambda r: not r.lights),
    "mesh file": replaced(mesh_files=lambda r: (r.xml,)),
    "XML": other_scene,
    "mesh": file_beside("0.ply", b"plz"),
    "a mesh more": file_beside("1.ply", b""),
    "libLLVM": other_library,
    "source": other_source,
    "processor": other_machine(processor, "description", lambda: "GenuineIntel family 6 model 142 (x86-64-v3)"),
    "instruction set": lambda request, patch: patch.setenv("LD_PRELOAD", "") or request,
    "version": other_machine(store, "installed_version", lambda name: "9"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_whatever_changes_is_requested_again(request_, monkeypatch, change):
    before = request_key(request_)
    with monkeypatch.context() as patch:
        changed = request_key(CHANGES[change](request_, patch))
    store.this_machine.cache_clear()
    assert changed != before and changed


def test_parts_of_a_key_do_not_run_into_one_another():
    assert len({key_of(parts) for parts in (["ab"], ["a", "b"], ["b", "a"], ["", "ab"], [b"a1"])}) == 5


DAMAGES = {
    "a flipped bit": lambda data: (
        data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :]
    ),
    "empty": lambda data: b"",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_or_of_another_name_is_requested_again(folder, request_, asked, damage):
    send_stored(request_)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(DAMAGES[damage](whole))
    assert not send_stored(request_).stored and len(asked) == 2
    assert file.read_bytes() == whole and send_stored(request_).stored
    other = replace(request_, d=-request_.d)
    (folder / f"{request_key(other)}{store.SUFFIX}").write_bytes(whole)
    assert not send_stored(other).stored and len(asked) == 3


def test_a_response_that_is_not_whole_is_requested_again(folder, request_, asked):
    """Its digest is right, as from a faulty store that several machines share."""
    nameless = response_of(request_)
    nameless.names.clear()
    for content in (b"", b"{}\n", nameless.to_bytes()):
        local_store().put(request_key(request_), content)
        assert not send_stored(request_).stored
    assert len(asked) == 3


@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_that_others_may_write_is_not_used(folder, request_, asked, mode):
    send_stored(request_)
    folder.chmod(mode)
    assert not send_stored(request_).stored and len(asked) == 2
    found = kept_results()
    assert not found.found and "other users may write it" in found.detail


def test_crashes_are_not_kept_and_a_folder_that_cannot_be_written_costs_time_only(
    folder, request_, monkeypatch, tmp_path, asked
):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(store.STORE_VARIABLE, str(tmp_path / "file" / "store"))
    assert not any(send_stored(request_).stored for _ in range(2)) and len(asked) == 2
    monkeypatch.setenv(store.STORE_VARIABLE, str(folder))
    crash = Crash(-signal.SIGABRT, "", 0.1)
    monkeypatch.setattr(mitsuba_process, "send_request", lambda *_: crash)
    assert send_stored(request_) is crash and not folder.exists()


def test_files_are_listed_a_few_times_and_the_limit_is_nearly_kept(tmp_path, monkeypatch):
    kept, listings, list_files = StoreFolder(tmp_path / "store", 100_000), [], StoreFolder._files
    monkeypatch.setattr(StoreFolder, "_files", lambda self: listings.append(1) or list_files(self))
    largest = 0
    for i in range(4000):
        kept.put(key_of([str(i)]), b"x" * 60)
        largest = max(largest, sum(file.stat().st_size for file in kept.folder.iterdir()) if i % 100 == 99 else 0)
    assert 50 < len(listings) < 400 and 90_000 < largest < 120_000


def test_the_least_recently_used_make_room(tmp_path):
    kept = StoreFolder(tmp_path / "store", 1000)
    for i, key in enumerate("abc"):
        kept.put(key, bytes(250))
        os.utime(kept.folder / f"{key}{store.SUFFIX}", (i, i))
    assert kept.use()[0] == 3 and kept.use()[1] < 1000
    assert kept.get("a") == bytes(250)  # used now, so b is the oldest
    kept.put("d", bytes(250))
    assert [kept.get(key) is not None for key in "abcd"] == [True, False, True, True]
    kept.put("e", bytes(1000))  # more than there is room for, whatever goes
    assert kept.get("e") is None and kept.use()[0] == 3


def test_settings(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv(store.LIMIT_VARIABLE, "7")
    monkeypatch.delenv(store.STORE_VARIABLE)
    kept = local_store()
    assert (kept.folder, kept.limit) == (tmp_path / "caster" / "store", 7 * 10**6)
    kept.put("a", bytes(10**6))
    found = kept_results()
    assert found.found and not found.needed and "1 results, 1 of 7 MB" in found.detail
    monkeypatch.setenv(store.STORE_VARIABLE, "off")
    assert local_store() is None and "off" in kept_results().detail


def test_two_processes_may_keep_the_same_content_at_the_same_time(tmp_path):
    kept, content = StoreFolder(tmp_path / "store", 10**8), bytes(10**6)
    child = os.fork()
    if child == 0:
        for _ in range(20):
            kept.put("a", content)
        os._exit(0)
    for _ in range(20):
        kept.put("a", content)
        assert kept.get("a") == content
    assert os.waitpid(child, 0)[1] == 0
    assert kept.get("a") == content and kept.use()[0] == 1
