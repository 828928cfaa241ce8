"""The report in a real browser: light and dark, on a desk and a phone, on paper. Skipped where there is no Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from station.report import Material, write_report
from tests.browsers import chromium
from tests.made_reports import arm_material

SCHEMES, WIDTHS = ("light", "dark"), (1280, 390)
# An A4 sheet within the page's margins of 12 mm, CSS px.
PAPER_PX = (210 - 2 * 12) / 25.4 * 96
NAMES = ("base_pan", "shoulder", "elbow_of_the_left_arm_abc", "wrist")

# Elements that reach beyond the page, save for those within one that scrolls.
OVERFLOWING = """limit => [...document.body.querySelectorAll('*')].filter(e => {
  if (e.closest('svg') && e.tagName !== 'svg') return false;
  for (let p = e.parentElement; p; p = p.parentElement)
    if (['auto', 'scroll'].includes(getComputedStyle(p).overflowX)) return false;
  const box = e.getBoundingClientRect();
  return box.width > 0 && (box.right > limit + 0.5 || box.left < -0.5);
}).map(e => e.tagName + '.' + e.className)"""
WIDER = """limit => [...document.querySelectorAll('table, pre, svg')].filter(
  e => e.getBoundingClientRect().right > limit + 1).map(e => e.outerHTML.slice(0, 200))"""
# The least contrast of a text with what is behind it, by the definition of WCAG 2, and of which.
CONTRAST = """() => {
  const parse = c => c.match(/[\\d.]+/g).map(Number);
  const linear = v => v / 255 <= .04045 ? v / 255 / 12.92 : ((v / 255 + .055) / 1.055) ** 2.4;
  const light = c => .2126 * linear(c[0]) + .7152 * linear(c[1]) + .0722 * linear(c[2]);
  const behind = e => { for (; e; e = e.parentElement) { const c = parse(getComputedStyle(e).backgroundColor);
                        if (c.length < 4 || c[3] > 0) return c; } return [255, 255, 255]; };
  const ratio = (a, b) => (Math.max(a, b) + .05) / (Math.min(a, b) + .05);
  const texts = [...document.body.querySelectorAll('*')].filter(e => !e.closest('svg') && e.checkVisibility() &&
    [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim()));
  const found = texts.map(e => [ratio(light(parse(getComputedStyle(e).color)), light(behind(e))),
                                e.tagName + ': ' + e.textContent.trim().slice(0, 40)]);
  return found.sort((a, b) => a[0] - b[0])[0];
}"""
# The contrast of the drawings' texts, which are outlines, with the page.
DRAWN = """() => {
  const probe = document.createElement('span'); document.body.append(probe);
  const colour = name => { probe.style.color = `var(--${name})`;
                           return getComputedStyle(probe).color.match(/\\d+/g).map(Number); };
  const linear = v => v / 255 <= .04045 ? v / 255 / 12.92 : ((v / 255 + .055) / 1.055) ** 2.4;
  const light = c => .2126 * linear(c[0]) + .7152 * linear(c[1]) + .0722 * linear(c[2]);
  const paper = light(colour('paper'));
  const least = Math.min(...['ink', 'detected', 'viewing'].map(n => light(colour(n)))
    .map(l => (Math.max(l, paper) + .05) / (Math.min(l, paper) + .05)));
  probe.remove(); return least;
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser")
    write_report(folder / "arm", arm_material(NAMES))
    write_report(folder / "nothing", Material("nothing"))
    return folder


class Opened:
    """A page, what it said on its console, what it asked for beside itself."""

    def __init__(self, browser: Any, path: Path, scheme: str, width: int) -> None:
        self.context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        self.page = self.context.new_page()
        self.said: list[str] = []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.said.append(request.url))
        self.page.goto(path.as_uri())
        self.said.remove(path.as_uri())

    def __enter__(self) -> Opened:
        return self

    def __exit__(self, *_: object) -> None:
        self.context.close()


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", ["arm", "nothing"])
def test_the_page_is_readable_keeps_within_the_screen_and_asks_for_nothing(browser, report, name, scheme, width):
    with Opened(browser, report / name / "report.html", scheme, width) as opened:
        assert opened.said == []
        for summary in opened.page.query_selector_all("summary"):
            summary.click()
        assert opened.page.evaluate("document.documentElement.scrollWidth") <= width
        assert opened.page.evaluate(OVERFLOWING, width) == []
        ratio, which = opened.page.evaluate(CONTRAST)
        assert ratio >= 4.5, which
        assert opened.page.evaluate(DRAWN) >= 4.5


def test_dark_pages_are_dark_and_paper_is_white_all_the_same(browser, report):
    with Opened(browser, report / "arm" / "report.html", "dark", 1280) as opened:
        background = "getComputedStyle(document.body).backgroundColor"
        assert opened.page.evaluate(background) == "rgb(22, 24, 28)"
        opened.page.emulate_media(media="print", color_scheme="dark")
        assert opened.page.evaluate(background) == "rgb(255, 255, 255)"


def test_links_lead_to_their_sections_below_the_list_of_them(browser, report):
    with Opened(browser, report / "arm" / "report.html", "light", 390) as opened:
        opened.page.click("nav a[href='#timing']")
        top = "document.querySelector('#timing h2').getBoundingClientRect().top"
        nav = "document.querySelector('nav').getBoundingClientRect().bottom"
        assert opened.page.evaluate(nav) <= opened.page.evaluate(top) < 450


def test_on_paper_no_table_is_cut_and_every_section_is_there(browser, report):
    pdfium = pytest.importorskip("pypdfium2")
    with Opened(browser, report / "arm" / "report.html", "light", round(PAPER_PX)) as opened:
        opened.page.emulate_media(media="print")
        assert opened.page.evaluate(WIDER, PAPER_PX) == []
        titles = opened.page.evaluate("[...document.querySelectorAll('h2')].map(e => e.textContent)")
        pdf = opened.page.pdf(prefer_css_page_size=True)
    with pdfium.PdfDocument(pdf) as document:
        texts = [page.get_textpage().get_text_bounded() for page in document]
    text = " ".join(texts)
    assert [title for title in titles if title not in text] == [] and "Settings" not in texts[0]
    assert not any(texts[k].rstrip().endswith(title) for k in range(len(texts)) for title in titles), "a heading alone"
