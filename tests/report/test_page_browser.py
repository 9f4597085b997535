"""The report page in a real browser, from disk, without a network: it works, asks for nothing, and all can use it."""

from __future__ import annotations

import importlib.util
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from laci_stereo.core.estimation.passage import Passage
from laci_stereo.match import match
from tests.cli_support import Site
from tests.detections import cam_rows, detection_rows, traffic
from tests.passages import passages, recorded, save

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
MODULES = [name for name in ("selenium", "axe_core_python") if importlib.util.find_spec(name) is None]
MISSING = [name for name, found in (("chromium", BROWSER), ("chromedriver", DRIVER)) if found is None] + MODULES

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(MISSING), reason=f"no {', '.join(MISSING)} here"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)
KINDS = ("stereo", "lidar", "detections", "combined")
DESKTOP, PHONE = (1280, 1000), (390, 844)


@pytest.fixture(scope="module")
def pages(calibrated_site: tuple[Site, str], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One page of each kind of sensor, as the commands write them."""
    root = tmp_path_factory.mktemp("pages")
    made = traffic(100)
    detection_rows(made, track_ids=True).write(root / "detections.csv")
    cam_rows(made.messages).write(root / "cam.csv")
    match(root / "detections.csv", root / "cam.csv").save(root / "detections")
    save(recorded()[0][1], root / "lidar")
    save(_combined(passages()), root / "combined")
    folders = {"stereo": calibrated_site[0].out} | {kind: root / kind for kind in KINDS[1:]}
    return {kind: folder / "report.html" for kind, folder in folders.items()}


def _combined(drives: list[Passage]) -> Any:
    from laci_stereo.core.combine import combine

    return combine(drives).calibration


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER or ""
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    yield driver
    driver.quit()


def show(browser: Any, page: Path, size: tuple[int, int] = DESKTOP, scheme: str = "light") -> None:
    screen = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size == PHONE}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    for log in ("browser", "performance"):
        browser.get_log(log)
    browser.get(page.as_uri())
    settle(browser)


def settle(browser: Any) -> None:
    """Wait until what follows the layout has run."""
    browser.execute_async_script("const done = arguments[0]; requestAnimationFrame(() => setTimeout(done, 50))")


def check(browser: Any) -> None:
    """Nothing was complained about, and nothing was asked for but the page and what is in it."""
    assert browser.get_log("browser") == []
    asked = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    urls = [each["params"]["request"]["url"] for each in asked if each["method"] == "Network.requestWillBeSent"]
    assert [url for url in urls if not url.startswith("data:")] == [browser.current_url.partition("#")[0]]


def first(browser: Any, selector: str) -> Any:
    from selenium.webdriver.common.by import By

    return browser.find_element(By.CSS_SELECTOR, selector)


def every(browser: Any, selector: str) -> list[Any]:
    from selenium.webdriver.common.by import By

    return list(browser.find_elements(By.CSS_SELECTOR, selector))


def transform(browser: Any, figure: str) -> list[float]:
    text = first(browser, f"{figure} .move").get_attribute("transform")
    return [float(number) for number in text[len("matrix(") : -1].split()]


def press(browser: Any, selector: str, *keys: str) -> None:
    """Send keys to an element that has the focus, as someone without a mouse does."""
    browser.execute_script("arguments[0].focus()", first(browser, selector))
    for key in keys:
        browser.switch_to.active_element.send_keys(key)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("size", "scheme"), [(DESKTOP, "light"), (DESKTOP, "dark"), (PHONE, "light"), (PHONE, "dark")])
def test_everyone_can_use_it(
    browser: Any, pages: dict[str, Path], kind: str, size: tuple[int, int], scheme: str
) -> None:
    import axe_core_python

    show(browser, pages[kind], size, scheme)
    browser.execute_script("for (const each of document.querySelectorAll('details')) { each.open = true; }")
    axe = Path(axe_core_python.__file__).with_name("axe.min.js").read_text(encoding="utf-8")
    browser.execute_script(axe)
    found = browser.execute_async_script(
        "const done = arguments[0]; axe.run(document, {resultTypes: ['violations', 'passes']}).then(done)"
    )
    bad = [each for each in found["violations"] if each["impact"] in ("serious", "critical")]
    assert [(each["id"], each["nodes"][0]["html"], each["nodes"][0]["failureSummary"]) for each in bad] == []
    assert len(found["passes"]) > 20  # it did look
    assert not every(browser, "main:empty")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_it_opens_from_disk_without_a_complaint_or_a_request(
    browser: Any, pages: dict[str, Path], kind: str, size: tuple[int, int]
) -> None:
    show(browser, pages[kind], size)
    check(browser)
    wider = browser.execute_script("return document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert wider <= 0
    assert len(every(browser, "section")) >= 9
    images = browser.execute_script(
        "return Promise.all([...document.querySelectorAll('image')].map((each) => "
        "{ const image = new Image(); image.src = each.href.baseVal; return image.decode().then(() => image.width); }))"
    )
    assert len(images) == (6 if kind == "stereo" else 0)


def test_what_is_asked_for_outside_would_be_seen(browser: Any, tmp_path: Path) -> None:
    page = tmp_path / "asks.html"
    page.write_text('<link rel="icon" href="data:,"><img src="http://asked.invalid/x.png">', encoding="utf-8")
    show(browser, page)
    with pytest.raises(AssertionError):
        check(browser)


def test_the_policy_stops_what_is_put_into_the_page(browser: Any, pages: dict[str, Path]) -> None:
    show(browser, pages["lidar"])
    browser.execute_script(
        "const s = document.createElement('script'); s.textContent = 'window.ran = true'; document.body.append(s);"
        "const i = document.createElement('img'); i.src = 'http://asked.invalid/y.png'; document.body.append(i);"
    )
    settle(browser)
    assert browser.execute_script("return window.ran") is None
    assert len([entry for entry in browser.get_log("browser") if "Content Security Policy" in entry["message"]]) >= 2


@pytest.mark.parametrize(("kind", "figure"), [("stereo", ".photo"), ("stereo", ".map"), ("lidar", ".map")])
def test_layers_can_be_shown_and_hidden(browser: Any, pages: dict[str, Path], kind: str, figure: str) -> None:
    show(browser, pages[kind])
    boxes = every(browser, f"{figure} input[data-layer]")
    assert len(boxes) >= 6
    for box in boxes:
        key = box.get_attribute("data-layer")
        part = f"{figure} g.key-{key}"
        before = browser.execute_script("return arguments[0].checked", box)
        for expected in (not before, before):
            press(browser, f"{figure} input[data-layer='{key}']", " ")
            shown = browser.execute_script(
                "const g = document.querySelector(arguments[0]); return getComputedStyle(g).display !== 'none'", part
            )
            assert shown == expected, key
    check(browser)


def test_frames_can_be_stepped_through(browser: Any, pages: dict[str, Path]) -> None:
    show(browser, pages["stereo"])
    captions = []
    for _ in range(7):
        visible = browser.execute_script(
            "return [...document.querySelectorAll('image')].filter((each) => each.checkVisibility()).length"
        )
        assert visible == 1
        captions.append(first(browser, ".photo figcaption").text)
        press(browser, ".photo button[data-do=after]", "\n")
    assert len(set(captions)) == 6
    assert captions[6] == captions[0]
    press(browser, ".photo button[data-do=before]", "\n")
    assert first(browser, ".photo figcaption").text == captions[0]
    press(browser, ".photo input[type=range]", "\ue011")  # Home
    assert "Frame 1 of 6" in first(browser, ".photo figcaption").text
    check(browser)


@pytest.mark.parametrize("figure", [".photo", ".map"])
@pytest.mark.parametrize("by", ["buttons", "keys"])
def test_pictures_move_and_grow(browser: Any, pages: dict[str, Path], figure: str, by: str) -> None:
    show(browser, pages["stereo"])
    start = transform(browser, figure)
    steps = {"in": "+", "left": "\ue012", "up": "\ue013", "right": "\ue014", "down": "\ue015", "out": "-", "fit": "0"}
    seen = {}
    for name, key in steps.items():
        if by == "keys":
            press(browser, f"{figure} .stage", key)
        else:
            press(browser, f"{figure} button[data-do={name}]", "\n")
        seen[name] = transform(browser, figure)
    assert start == seen["fit"] == [1, 0, 0, 1, 0, 0]
    assert seen["in"][0] > 1
    assert seen["left"][4] > seen["in"][4]
    assert seen["up"][5] > seen["in"][5]
    assert seen["down"][4:] == pytest.approx(seen["in"][4:])
    assert seen["out"] == pytest.approx(start)
    check(browser)


def test_the_map_follows_the_pointer(browser: Any, pages: dict[str, Path]) -> None:
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    show(browser, pages["lidar"])
    stage = first(browser, ".map .stage")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", stage)
    ActionChains(browser).move_to_element(stage).click_and_hold().move_by_offset(60, -30).release().perform()
    unit = browser.execute_script("return 960 / document.querySelector('.map svg[role=img]').clientWidth")
    assert transform(browser, ".map")[4:] == pytest.approx([60 * unit, -30 * unit], abs=1.0)
    before = browser.execute_script("return scrollY")
    assert browser.execute_script("return document.activeElement === arguments[0]", stage)
    ActionChains(browser).scroll_from_origin(ScrollOrigin.from_element(stage), 0, -100).perform()
    settle(browser)
    assert transform(browser, ".map")[0] > 1
    assert browser.execute_script("return scrollY") == before
    check(browser)


def test_what_is_under_the_pointer_is_named(browser: Any, pages: dict[str, Path]) -> None:
    from selenium.webdriver import ActionChains

    show(browser, pages["lidar"])
    stage = first(browser, ".map .stage")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", stage)
    moments = json.loads(first(browser, ".map").get_attribute("data-moments"))
    left, top, scale = browser.execute_script(
        "const b = document.querySelector('.map svg[role=img]').getBoundingClientRect();"
        "return [b.left, b.top, b.width / 960]"
    )
    x, y, text = moments[len(moments) // 2]
    move = ActionChains(browser)
    move.w3c_actions.pointer_action.move_to_location(round(left + scale * x), round(top + scale * y))
    move.perform()
    assert first(browser, ".map .tip").text == text
    move = ActionChains(browser)
    move.w3c_actions.pointer_action.move_to_location(round(left + 3), round(top + scale * 630))
    move.perform()
    assert not first(browser, ".map .tip").is_displayed()
    check(browser)


def test_moments_can_be_read_without_a_pointer(browser: Any, pages: dict[str, Path]) -> None:
    show(browser, pages["lidar"])
    moments = json.loads(first(browser, ".map").get_attribute("data-moments"))
    for expected in (0, 1):
        press(browser, ".map button[data-do=after]", "\n")
        assert first(browser, ".map figcaption [data-caption]").text == moments[expected][2]
        assert first(browser, ".map .here").get_attribute("d")
    for expected in (0, -1):
        press(browser, ".map button[data-do=before]", "\n")
        assert first(browser, ".map figcaption [data-caption]").text == moments[expected][2]
    check(browser)


def test_the_scale_bar_tells_the_truth_at_every_zoom(browser: Any, pages: dict[str, Path]) -> None:
    show(browser, pages["lidar"])
    scale = float(first(browser, ".map").get_attribute("data-scale"))
    for _ in range(12):
        number, unit = first(browser, ".map .bar text").text.split()
        metres = float(number) * {"m": 1.0, "cm": 0.01}[unit]
        d = first(browser, ".map .bar path").get_attribute("d")
        start, end = float(d[1:].split()[0]), float(d.split("H")[1].split("V")[0])
        assert (end - start) / (scale * transform(browser, ".map")[0]) == pytest.approx(metres, rel=1e-6)
        assert 40 < end - start < 400
        press(browser, ".map .stage", "+")
    check(browser)


def test_the_transform_can_be_copied(browser: Any, pages: dict[str, Path]) -> None:
    show(browser, pages["lidar"])
    allowed = {"permission": {"name": "clipboard-write"}, "setting": "granted"}
    browser.execute_cdp_cmd("Browser.setPermission", allowed)
    press(browser, "button[data-copy=T_utm_sensor]", "\n")
    settle(browser)
    said = first(browser, ".matrix [role=status]").text
    assert said.startswith(("Copied", "Selected"))
    if said.startswith("Selected"):
        selected = browser.execute_script("return String(getSelection())")
        assert selected.strip() == first(browser, "pre[data-name=T_utm_sensor]").text.strip()
    check(browser)


@pytest.mark.parametrize("kind", KINDS)
def test_type_is_large_enough_on_a_phone(browser: Any, pages: dict[str, Path], kind: str) -> None:
    show(browser, pages[kind], PHONE)
    heights = browser.execute_script(
        "return [...document.querySelectorAll('svg text')].filter((t) => t.checkVisibility())"
        ".map((t) => t.getBoundingClientRect().height)"
    )
    assert min(heights) > 11


@pytest.mark.parametrize("kind", KINDS)
def test_it_prints_on_a4_with_the_settings(browser: Any, pages: dict[str, Path], kind: str) -> None:
    show(browser, pages[kind])
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    shown = browser.execute_script(
        "dispatchEvent(new Event('beforeprint'));"
        "const buttons = [...document.querySelectorAll('button')].filter((b) => b.checkVisibility()).length;"
        "const settings = document.querySelector('#settings table').checkVisibility();"
        "dispatchEvent(new Event('afterprint')); return [buttons, settings, !!document.querySelector('details[open]')]"
    )
    assert shown == [0, True, False]
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    assert len(printed["data"]) > 10_000
