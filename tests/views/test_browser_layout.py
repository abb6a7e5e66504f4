"""How the report page looks: in the dark, in narrow windows, on paper."""

import base64
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from browser import next_frame
from browser_report import chrome as chrome
from browser_report import page as page
from browser_report import picture
from browser_report import shown as shown
from PIL import Image
from selenium import webdriver

pytestmark = pytest.mark.browser


def test_it_is_dark_where_the_system_is(shown: webdriver.Chrome) -> None:
    light = picture(shown)
    with media(shown, features=[{"name": "prefers-color-scheme", "value": "dark"}]):
        dark, readable = picture(shown), contrast(shown)
    assert light.mean() > 190
    assert dark.mean() < 80
    assert min(readable, contrast(shown)) > 4.5


def contrast(chrome: webdriver.Chrome) -> float:
    """Smallest contrast (WCAG 2) of a colour of text with the paper."""
    names = ("ink", "faint", "planned-ink", "baseline", "bad", "good", "paper")
    script = """const style = getComputedStyle(document.documentElement);
        return arguments[0].map((name) => style.getPropertyValue(`--${name}`));"""
    colours = [value.strip().lstrip("#") for value in chrome.execute_script(script, names)]
    *texts, paper = (luminance(c if len(c) == 6 else "".join(2 * x for x in c)) for c in colours)
    return min((max(text, paper) + 0.05) / (min(text, paper) + 0.05) for text in texts)


def luminance(colour: str) -> float:
    parts = np.array([int(colour[k : k + 2], 16) / 255 for k in (0, 2, 4)])
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_the_printed_page_is_still_and_shows_every_plot(shown: webdriver.Chrome) -> None:
    shown.execute_script("cmbotReplay.seek(7)")
    pdf = base64.b64decode(shown.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})["data"])
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 10
    stills = shown.execute_script("return [...document.querySelectorAll('#stills img')].map((i) => i.src)")
    assert len(stills) == 4 == len(set(stills))  # the ends of the legs
    image = Image.open(io.BytesIO(base64.b64decode(stills[0].split(",")[1]))).convert("RGB")
    assert len(np.unique(np.asarray(image).reshape(-1, 3), axis=0)) > 300
    assert shown.execute_script("return cmbotReplay.time") == 7
    with media(shown, media="print"):
        hidden = shown.execute_script(
            """const seen = (name) => document.querySelector(name).getBoundingClientRect().height > 0;
            const kept = [...document.querySelectorAll("svg, .part, #stills")];
            const there = kept.every((element) => element.getBoundingClientRect().height > 20);
            return [["#bar", "#view", "footer"].filter(seen), there];"""
        )
    assert hidden == [[], True]


def test_what_belongs_together_is_printed_on_one_page(shown: webdriver.Chrome) -> None:
    """Nothing but a long table is parted, and what must not be parted is shorter than a page of A4."""
    with screen(shown, 703), printing(shown), media(shown, media="print"):  # 186 mm
        kept = shown.execute_script(
            """const names = ".card, .chart, #stills, #joints, .part:not(.long)";
            const kept = [...document.querySelectorAll(names)];
            return kept.map((one) => {
                return [getComputedStyle(one).breakInside, one.getBoundingClientRect().height];
            });"""
        )
        parted = shown.execute_script(
            "return [...document.querySelectorAll('.part.long h2')].map((heading) => heading.textContent)"
        )
    assert {how for how, _ in kept} == {"avoid"}
    assert max(height for _, height in kept) < 273 / 25.4 * 96
    assert parted == ["Simulation"]


@pytest.mark.parametrize("width", [1280, 420])
def test_nothing_is_written_over_the_curves_of_a_small_plot(shown: webdriver.Chrome, width: int) -> None:
    with screen(shown, width):
        overlaps = shown.execute_script(
            """const box = (element) => element.getBoundingClientRect();
            const meets = (a, b) => a.left < b.right && b.left < a.right
                && a.top < b.bottom - 2 && b.top < a.bottom - 2;
            return [...document.querySelectorAll(".small svg")].filter((svg) => {
                const all = [...svg.querySelectorAll(".corner")].map(box);
                const frame = box(svg.querySelector(".frame")), whole = box(svg);
                const out = all.some(({ left, right }) => left < whole.left - 1 || right > whole.right + 1);
                return out || all.some((text) => meets(text, frame)) || meets(all[0], all[2]);
            }).map((svg) => svg.getAttribute("aria-label"));"""
        )
    assert overlaps == []


@pytest.mark.parametrize("width", [1280, 1024, 420, 320])
def test_what_a_card_says_stays_on_it(shown: webdriver.Chrome, width: int) -> None:
    with screen(shown, width):
        spilling = shown.execute_script(
            """const spills = ({scrollWidth, clientWidth}) => clientWidth > 0 && scrollWidth > clientWidth;
            const parts = [...document.querySelectorAll(".card, .card *")];
            const reaches = (card) => Math.max(...[...card.querySelectorAll("*")].map((part) => {
                return part.getBoundingClientRect().right - card.getBoundingClientRect().right;
            }));
            return [parts.filter(spills).map((part) => part.textContent),
                Math.max(...[...document.querySelectorAll(".card")].map(reaches))];"""
        )
    assert spilling[0] == []
    assert spilling[1] < -8


def test_nothing_covers_the_controls(shown: webdriver.Chrome) -> None:
    with screen(shown, 420):
        covered = shown.execute_script(
            """const controls = [...document.querySelectorAll("#bar button, #bar select, #bar input")];
            return controls.filter((control) => {
                const { x, y, width, height } = control.getBoundingClientRect();
                return document.elementFromPoint(x + width / 2, y + height / 2) !== control;
            }).map((control) => control.id);"""
        )
    assert covered == []


def test_a_narrow_window_prints_as_a_wide_one(shown: webdriver.Chrome) -> None:
    printed = []
    for width in (1280, 860, 420):
        with screen(shown, width):
            before = view_and_plots(shown)
            with printing(shown):
                stills = shown.execute_script(
                    """const stills = [...document.querySelectorAll("#stills img")];
                    return Promise.all(stills.map((image) => image.decode())).then(
                        () => stills.map((image) => [image.naturalWidth, image.naturalHeight]));"""
                )
                printed.append([stills, view_and_plots(shown)[1:]])
            next_frame(shown)
            assert view_and_plots(shown) == before
    assert printed[0] == printed[1] == printed[2]
    assert all(0.7 < wide / high < 1.4 for wide, high in printed[0][0])


def view_and_plots(chrome: webdriver.Chrome) -> list[object]:
    """Size of the view, px, and what the plots are drawn for."""
    return chrome.execute_script(
        """const view = document.getElementById("view");
        const boxes = [...document.querySelectorAll("svg")].map((svg) => svg.getAttribute("viewBox"));
        return [[view.clientWidth, view.clientHeight], boxes];"""
    )


@contextmanager
def screen(chrome: webdriver.Chrome, width: int) -> Iterator[None]:
    """Another width of the window for a while."""
    metrics = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    next_frame(chrome)
    try:
        yield
    finally:
        chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics | {"width": 1280})
        next_frame(chrome)


@contextmanager
def media(chrome: webdriver.Chrome, **settings: object) -> Iterator[None]:
    """Emulate a medium or its features for a while."""
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", settings)
    try:
        yield
    finally:
        chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})


@contextmanager
def printing(chrome: webdriver.Chrome) -> Iterator[None]:
    """Prepare the page for the printer for a while."""
    chrome.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    try:
        yield
    finally:
        chrome.execute_script("window.dispatchEvent(new Event('afterprint'))")
