"""The page at ``/`` in a real browser: choose, register, look, download, and read of errors."""

from __future__ import annotations

import json
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
import uvicorn
from fastapi.testclient import TestClient
from service_contract import rotation_error_deg

from app.example_pair import ExamplePair
from app.service import create_app
from app.settings import ServiceSettings
from model import Registrar
from model.cloud_file import read_points, write_points

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="neither chromium nor chromium-driver is installed"
)
webdriver = pytest.importorskip("selenium.webdriver", reason="selenium isn't installed")

PHONE, DESKTOP = (390, 844), (1280, 900)
_T = TypeVar("_T")


class Browser:
    """Chromium with the page open, by the names that its elements have."""

    def __init__(self, downloads: Path) -> None:
        options = webdriver.ChromeOptions()
        options.binary_location = CHROMIUM
        for argument in (
            "--headless=new", "--no-sandbox", "--disable-dev-shm-usage",
            "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
        ):  # fmt: skip
            options.add_argument(argument)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.downloads = downloads
        self.driver = webdriver.Chrome(options, webdriver.ChromeService(DRIVER))
        self.command("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(downloads))

    def command(self, name: str, **arguments: object) -> None:
        self.driver.execute_cdp_cmd(name, arguments)

    def look(self, size: tuple[int, int], scheme: str) -> None:
        width, height = size
        self.command(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=width < 600,
        )  # fmt: skip
        scheme_feature = {"name": "prefers-color-scheme", "value": scheme}
        self.command("Emulation.setEmulatedMedia", features=[scheme_feature])

    def element(self, name: str) -> object:
        return self.driver.find_element("id", name)

    def text(self, name: str) -> str:
        return self.element(name).text

    def script(self, text: str) -> object:
        return self.driver.execute_script(text)

    def until(self, happened: Callable[[], _T], seconds: float = 60) -> _T:
        end = time.monotonic() + seconds
        while not (value := happened()):
            assert time.monotonic() < end, self.text("problem") or "it didn't happen"
            time.sleep(0.05)
        return value

    def shown(self, name: str) -> bool:
        return bool(self.element(name).is_displayed())

    def registered(self) -> None:
        self.until(lambda: self.element("register").is_enabled())
        self.element("register").click()
        self.until(lambda: self.shown("result"))

    def shot(self, name: str) -> bytes:
        """A picture of the whole page, kept where EQUIVALIGN_SCREENSHOTS says."""
        picture = self.driver.get_screenshot_as_png()
        folder = os.environ.get("EQUIVALIGN_SCREENSHOTS")
        if folder:
            Path(folder, f"{name}.png").write_bytes(picture)
        return bytes(picture)

    def colours(self) -> int:
        """How many pixels of the view are drawn on, once what was asked for is drawn."""
        count = self.driver.execute_async_script(
            "const done = arguments[0];"
            "requestAnimationFrame(() => requestAnimationFrame(() => {"
            "const c = document.getElementById('canvas'), gl = c.getContext('webgl');"
            "const p = new Uint8Array(4 * c.width * c.height);"
            "gl.readPixels(0, 0, c.width, c.height, gl.RGBA, gl.UNSIGNED_BYTE, p);"
            "let n = 0; for (let i = 3; i < p.length; i += 4) n += p[i] > 0; done(n); }));"
        )
        return int(count)


@pytest.fixture(scope="module")
def address(registrar: Registrar) -> Iterator[str]:
    """A real server: a browser speaks to nothing else."""
    app = create_app(lambda: registrar, ServiceSettings(max_points=50_000))
    server = uvicorn.Server(uvicorn.Config(app, port=0, log_config=None, access_log=False))
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        time.sleep(0.02)
    port = server.servers[0].sockets[0].getsockname()[1]
    yield f"http://127.0.0.1:{port}"
    server.should_exit = True
    thread.join(30)


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    browser = Browser(tmp_path_factory.mktemp("downloads"))
    yield browser
    browser.driver.quit()


@pytest.fixture
def page(chromium: Browser, address: str) -> Browser:
    chromium.look(DESKTOP, "light")
    chromium.driver.get(address)
    chromium.until(lambda: chromium.driver.find_elements("css selector", "#examples button"))
    return chromium


def choose_files(page: Browser, *paths: Path) -> None:
    for role, path in zip(("source", "target"), paths, strict=False):
        page.element(role).send_keys(str(path))


@pytest.mark.parametrize(("size", "scheme"), [(DESKTOP, "light"), (PHONE, "dark")])
def test_an_example_is_registered_and_shown(
    page: Browser, size: tuple[int, int], scheme: str
) -> None:
    page.look(size, scheme)
    page.shot(f"{scheme}-before")
    example = page.driver.find_elements("css selector", "#examples button")[0]
    example.click()
    page.until(
        lambda: "points" in page.text("source-file") and "points" in page.text("target-file")
    )
    assert example.get_attribute("aria-pressed") == "true"
    page.until(lambda: page.colours() > 1000)
    page.until(lambda: page.element("register").is_enabled())
    page.element("register").click()
    page.until(lambda: page.shown("progress") or page.shown("result"))
    page.shot(f"{scheme}-during")
    page.until(lambda: page.shown("result"))
    page.until(lambda: not page.shown("progress"))
    page.shot(f"{scheme}-after")
    assert "overlap" in page.text("verdict") or "right" in page.text("verdict")
    assert page.driver.find_elements("css selector", "#convergence svg path.curve")
    assert page.script("return document.documentElement.scrollWidth <= innerWidth")
    assert [entry for entry in page.driver.get_log("browser") if entry["level"] == "SEVERE"] == []


def test_the_answer_of_files_and_its_downloads(
    page: Browser, pair_files: tuple[Path, Path], pair: ExamplePair
) -> None:
    choose_files(page, *pair_files)
    page.registered()
    found = {
        box.find_element("tag name", "h3").text: box.find_element("tag name", "pre").text
        for box in page.driver.find_elements("class name", "notation")
    }
    T = np.array([line.split() for line in found["Matrix 4×4"].splitlines()], float)
    assert rotation_error_deg(T, pair.T_target_source) < 1.0
    assert {"Quaternion x y z w", "TUM: time x y z, quaternion x y z w"} <= found.keys()
    findings = page.text("findings")
    assert "Overlap" in findings
    for button, name in (
        ("ply", "aligned.ply"),
        ("report", "report.html"),
        ("json", "answer.json"),
    ):
        page.element(f"download-{button}").click()
        page.until((page.downloads / name).is_file)
    aligned = read_points(page.downloads / "aligned.ply", "aligned")
    np.testing.assert_allclose(aligned, pair.target, atol=0.05)
    assert "Convergence" in (page.downloads / "report.html").read_text()
    document = json.loads((page.downloads / "answer.json").read_text())
    np.testing.assert_allclose(document["T_target_source"], T, atol=1e-6)


def test_what_is_shown_follows_the_controls(page: Browser, pair_files: tuple[Path, Path]) -> None:
    choose_files(page, *pair_files)
    page.registered()
    page.until(lambda: page.colours() > 100)
    everything = page.colours()
    # Vectors, then clouds: each takes its pixels with it.
    for name in ("arrows", "aligned", "target"):
        page.element(f"show-{name}").click()
        page.until(lambda before=everything: page.colours() < before)
        everything = page.colours()
    assert everything == 0
    page.element("show-aligned").click()
    few = page.until(page.colours)
    page.script("const s = document.getElementById('size'); s.value = 12;"
                "s.dispatchEvent(new Event('input'));")  # fmt: skip
    page.until(lambda: page.colours() > 1.5 * few)
    # The motion slider brings the aligned cloud back to where the source came from.
    page.script("const s = document.getElementById('motion'); s.value = 0;"
                "s.dispatchEvent(new Event('input'));")  # fmt: skip
    there = page.until(page.colours)
    for name in ("aligned", "source"):
        page.element(f"show-{name}").click()
    page.until(lambda: abs(page.colours() - there) <= 0.02 * there)
    page.element("play").click()
    page.until(lambda: page.script("return document.getElementById('motion').value === '100'"))


def test_errors_are_told_in_plain_words(page: Browser, tmp_path: Path) -> None:
    broken, good = tmp_path / "broken.ply", tmp_path / "line.xyz"
    broken.write_bytes(b"ply\nformat ascii 1.0\n")
    good.write_bytes(b"".join(b"%d 0 0\n" % i for i in range(9)))
    choose_files(page, broken)
    page.until(lambda: page.shown("problem"))
    page.shot("error")
    said = page.text("problem")
    assert said.startswith("source: the file has no PLY header")
    assert "What to do" in said
    assert not page.element("register").is_enabled()
    choose_files(page, good)
    page.until(lambda: "one line" in page.text("problem"))


def test_a_pair_that_is_too_large_is_refused(page: Browser, tmp_path: Path) -> None:
    large = tmp_path / "large.npy"
    write_points(large, np.random.default_rng(0).normal(size=(50_001, 3)))
    choose_files(page, large)
    page.until(lambda: "too many points" in page.text("problem"))


def test_it_needs_no_internet_and_works_by_keyboard(page: Browser, address: str) -> None:
    page.driver.get_log("performance")
    page.driver.get(address)
    page.until(lambda: page.driver.find_elements("css selector", "#examples button"))
    events = [
        json.loads(entry["message"])["message"] for entry in page.driver.get_log("performance")
    ]
    asked = [
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    ]
    assert len(asked) > 4
    assert [url for url in asked if not url.startswith((address, "data:", "blob:"))] == []

    reached = []
    for _ in range(12):
        webdriver.ActionChains(page.driver).send_keys("\ue004").perform()  # the tab key
        focused = page.driver.switch_to.active_element
        reached.append(focused.get_attribute("id") or focused.text.splitlines()[0])
    assert {"Skip to the result", "Two scans of a part", "source", "target"} <= set(reached)
    unnamed = page.script(
        "return [...document.querySelectorAll('button, input, select, canvas')].filter(e =>"
        "!(e.getAttribute('aria-label') || e.labels?.length || e.textContent.trim()))"
        ".map(e => e.id)"
    )
    assert unnamed == []


def test_nobody_may_frame_it_or_add_scripts(client: TestClient) -> None:
    answer = client.get("/")
    assert answer.headers["content-type"].startswith("text/html")
    assert "frame-ancestors 'none'" in answer.headers["content-security-policy"]
    assert "unsafe" not in answer.headers["content-security-policy"]
    for name in ("page.js", "viewer.js", "convergence.js", "page.css", "icon.svg"):
        assert client.get(f"/page/{name}").status_code == 200


def test_every_example_can_be_loaded(client: TestClient, tmp_path: Path) -> None:
    examples = client.get("/page/examples.json").json()
    assert len(examples) >= 3
    for example in examples:
        for role in ("source", "target"):
            path = tmp_path / example[role]
            path.write_bytes(client.get(f"/page/{example[role]}").content)
            assert len(read_points(path, role)) > 100
