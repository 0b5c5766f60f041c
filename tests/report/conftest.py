"""A browser, and reports for it to open. Where there is no Chromium, the run's header and each test say so."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import planted
import pytest
import textbook_pages
from playwright.sync_api import Browser, Page, sync_playwright

from mitsuba_ref.judge.verdict import SceneVerdict
from mitsuba_ref.report.validation import Validation

# As root, as in containers, Chromium does not start with its sandbox; and it opens nothing here but our own files.
OPTIONS = ["--no-sandbox"]
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
SIZE = {"width": 1280, "height": 800}


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    path = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if path is None:
        pytest.skip("no Chromium on this machine: reports are not opened (apt install chromium)")
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=path, args=OPTIONS)
        yield opened
        opened.close()


@dataclass
class Opened:
    """A page, and what must not happen in it."""

    page: Page
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def address(self) -> str:
        """What follows the # once the page has come to rest."""
        self.page.wait_for_timeout(300)  # longer than REST_MS of page/state.js
        return str(self.page.evaluate("location.hash"))


@pytest.fixture
def visit(browser: Browser) -> Iterator[Callable[..., Opened]]:
    """Open a report; in the end nothing may have been asked for but files, and nothing have gone wrong."""
    contexts, visits = [], []

    def open_it(path: Path, place: str = "", **options: object) -> Opened:
        contexts.append(browser.new_context(viewport=options.pop("viewport", SIZE), **options))
        page = contexts[-1].new_page()
        page.set_default_timeout(10_000)
        opened = Opened(page)
        visits.append(opened)
        page.on("console", lambda said: said.type == "error" and opened.errors.append(said.text))
        page.on("pageerror", lambda error: opened.errors.append(str(error)))
        page.on("request", lambda request: opened.requests.append(request.url))
        page.goto(f"{path.as_uri()}{place}")
        return opened

    yield open_it
    for context in contexts:
        context.close()
    assert [opened.errors for opened in visits if opened.errors] == []
    kinds = {url.split(":", 1)[0] for opened in visits for url in opened.requests}
    assert kinds <= {"file", "data", "blob"}, "a request left the page"


@pytest.fixture(scope="session")
def verdicts() -> dict[str, SceneVerdict]:
    """A scene that passes, one with faults at four pixels, and one whose reference gave no answer."""
    with pytest.MonkeyPatch.context() as patch:
        bad = planted.bad(patch)
    crashed = SceneVerdict("crashed", "scenes/crashed.toml", 480, problem="Mitsuba ended (SIGSEGV): <b>words</b>")
    return {"good": planted.judged("good"), "bad": bad, "crashed": crashed}


@pytest.fixture(scope="session")
def judged() -> dict[str, SceneVerdict]:
    """The textbook caster of docs/candidates, in several settings."""
    return textbook_pages.verdicts()


@pytest.fixture(scope="session")
def folder(verdicts: dict[str, SceneVerdict], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of these three: its index.html."""
    return Validation(tuple(verdicts.values()), scene_count=4).write_html(tmp_path_factory.mktemp("report") / "html")
