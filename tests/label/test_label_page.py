"""The page in a real browser: by mouse, by keyboard, with the server killed under it, with a
thousand boxes.
"""

import contextlib
import time
from collections.abc import Iterator

import numpy as np
import pytest
from page_cases import FRAMES, SIZE, server

from browsers import faults, needs_browser
from phdtrack.label import Label, LabelStore

pytestmark = [needs_browser, pytest.mark.slow]
VIEWPORT = {"width": 1280, "height": 800}
KEPT = '#saving:text-is("all kept")'


class Page:
    """A page with the picture's coordinates."""

    def __init__(self, page):
        self.page = page
        self.errors = []
        page.on("pageerror", lambda error: self.errors.append(str(error)))

    def open(self, url):
        self.page.goto(url)
        self.ready()

    def ready(self):
        self.page.wait_for_selector("body[data-ready]")
        area = self.page.locator("#canvas").bounding_box()
        self.scale = min(area["width"] / SIZE[0], area["height"] / SIZE[1])
        self.left = area["x"] + (area["width"] - SIZE[0] * self.scale) / 2
        self.top = area["y"] + (area["height"] - SIZE[1] * self.scale) / 2

    def point(self, x, y):
        return self.left + x * self.scale, self.top + y * self.scale

    def click(self, x, y):
        self.page.mouse.click(*self.point(x, y))

    def kept(self):
        self.page.wait_for_selector(KEPT)

    def frame(self, number):
        self.page.wait_for_selector(f'#title:text-matches("frame {number}$")')


@contextlib.contextmanager
def opened(browser, url) -> Iterator[Page]:
    """A page; a browser's are strangers to each other, those of a context are tabs of one."""
    page = Page(browser.new_page(**({} if hasattr(browser, "pages") else {"viewport": VIEWPORT})))
    page.open(url)
    yield page
    assert page.errors == []
    page.page.close()


@pytest.fixture
def context(browser):
    context = browser.new_context(viewport=VIEWPORT)
    yield context
    context.close()


@pytest.fixture
def store(tmp_path):
    return LabelStore(tmp_path / "labels.sqlite")


@pytest.fixture
def it(browser, store):
    with server(store.path) as (url, _), opened(browser, url) as page:
        yield page


def test_frames_by_mouse(it, store):
    for number in (1, 2):
        it.frame(number)
        # Inside the first box lies a small one: that is what a click means; and one more elsewhere.
        it.click(56, 56)
        it.click(200, 60)
        it.page.click("#done")
    it.kept()
    assert "2 of 40 frames · 4 false · 0 births" in it.page.inner_text("#progress")
    found = {(label.frame, label.box) for label in store.labels()}
    assert found == {(number, box) for number in (1, 2) for box in (12, 1)}


def test_forty_frames_by_keyboard(it, store):
    for number in range(1, FRAMES + 1):
        it.frame(number)
        for key in ("Tab", "Tab", "x", "Tab", "2", "x", "1", "Enter"):
            it.page.keyboard.press(key)
    it.kept()
    marks = {(label.frame, label.box): label.mark for label in store.labels()}
    expected = {
        (n, box): mark for n in range(1, FRAMES + 1) for box, mark in ((1, "false"), (2, "birth"))
    }
    # Before the first frame of all there is none: who is there may have been there before.
    del expected[1, 2]
    assert marks == expected
    assert store.progress().done == FRAMES
    # What comes next is said, with the file of these marks; births are learned from as many marks.
    it.page.wait_for_selector("#next-step:visible")
    command = f"phdtrack learn drawn.mp4 --labels {store.path} --births hand"
    assert (
        it.page.inner_text("#next-step")
        == f"All 40 frames are done. Now run in a terminal: {command}"
    )
    assert it.page.inner_text("#kept") == str(store.path)
    it.page.keyboard.press("z")
    it.page.wait_for_selector("#next-step", state="hidden")


def test_a_phone_on_its_side_has_the_picture_beside_the_buttons(it):
    it.frame(1)
    it.page.set_viewport_size({"width": 844, "height": 390})
    assert it.page.evaluate("document.documentElement.scrollWidth") <= 844
    picture, button = (it.page.locator(name).bounding_box() for name in ("#canvas", "#done"))
    assert picture["height"] > 250
    assert button["x"] > picture["x"] + picture["width"] - 1


def test_marks_of_many_boxes_are_reported_and_keys_still_work(it, store):
    it.frame(1)
    for key in ("Tab", "Tab"):
        it.page.keyboard.press(key)
    it.page.click("#alike:enabled")
    it.kept()
    said = it.page.inner_text("#notice")
    assert said == f"{len(store.labels())} boxes were marked as false; Z undoes it"
    # The mouse has left the picture, and the keys are still for it.
    it.page.keyboard.press("z")
    it.kept()
    assert "taken back" in it.page.inner_text("#notice")
    it.page.keyboard.press("Enter")
    it.kept()
    assert (store.labels(), store.progress().done) == ([], 1)


@pytest.mark.parametrize("width", [390, 800])
def test_a_narrow_window_has_the_picture_above_the_buttons(it, width: int):
    it.frame(1)
    it.page.set_viewport_size({"width": width, "height": 844})
    assert it.page.evaluate("document.documentElement.scrollWidth") <= width
    picture, button = (it.page.locator(name).bounding_box() for name in ("#canvas", "#done"))
    assert picture["width"] == width
    assert picture["height"] > 300
    assert button["y"] > picture["y"] + picture["height"]


@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1280, "light")])
def test_axe_finds_no_serious_fault(it, width: int, scheme: str):
    it.page.set_viewport_size({"width": width, "height": 800})
    it.page.emulate_media(color_scheme=scheme)
    it.frame(1)
    it.click(200, 60)
    it.kept()
    assert faults(it.page) == []
    shown_by = (
        ("w", "#wall"),
        ("w", "#canvas"),
        ("s", "#sweep"),
        ("Escape", "#canvas"),
        ("2", "#clip"),
        ("n", "#rule-true"),
    )
    for key, shown in shown_by:
        it.page.locator("#canvas").focus()
        it.page.keyboard.press(key)
        it.page.wait_for_selector(f"{shown}:visible")
        assert faults(it.page) == [], shown


def dragged(it, *corners):
    it.page.mouse.move(*it.point(*corners[0]))
    it.page.mouse.down()
    for corner in corners[1:]:
        it.page.mouse.move(*it.point(*corner), steps=4)
    it.page.mouse.up()


def test_missed_objects_are_drawn_and_boxes_moved(it, store):
    press = it.page.keyboard.press
    press("3")
    dragged(it, (30, 160), (90, 200))
    it.kept()
    (drawn,) = store.labels()
    assert (drawn.frame, drawn.mark) == (1, "true")
    assert drawn.place == pytest.approx((30, 160, 90, 200), abs=0.7)
    assert "1 drawn" in it.page.inner_text("#progress")
    # What was drawn is chosen: its edge is dragged, and then all of it, which stays in the picture.
    dragged(it, (90, 180), (100, 180))
    dragged(it, (60, 180), (60, 600))
    it.kept()
    assert store.labels()[0].place == pytest.approx((30, 440, 100, 480), abs=1)
    press("z")
    it.page.wait_for_selector("#redo:enabled")
    it.kept()
    assert store.labels()[0].place == pytest.approx((30, 160, 100, 200), abs=1)
    # A detection: a click chooses it.
    it.click(200, 60)
    dragged(it, (200, 60), (210, 70))
    it.kept()
    moved = store.labels()[0]
    assert (moved.box, moved.mark) == (1, "true")
    assert moved.place == pytest.approx((180, 30, 300, 150), abs=1)
    it.page.mouse.move(*it.point(5, 5))
    it.page.wait_for_selector('#tip:text-matches("120×120 · set by hand, by ")')
    # It can be false after all; a drawn box cannot be false and is taken away.
    press("1")
    for point in ((295, 145), (60, 180)):
        it.click(*point)
    it.kept()
    assert store.labels() == [Label(1, 1, "false")]
    # Only on the drawn frame.
    press("3")
    press(".")
    it.page.wait_for_selector('#when:text-is("frame 2 (+1)")')
    dragged(it, (30, 160), (90, 200))
    it.page.wait_for_selector('#notice:text-matches("on the drawn frame itself")')
    assert store.labels() == [Label(1, 1, "false")]


def test_the_keyboard_draws_and_moves_boxes_without_a_server(browser, tmp_path):
    labels = tmp_path / "labels.sqlite"
    with server(labels) as (url, process), opened(browser, url) as it:
        port = int(url.rsplit(":", 1)[1].strip("/"))
        press = it.page.keyboard.press
        process.kill()
        process.wait()
        press("n")
        assert it.page.inner_text("#spoken").startswith(
            "box 14 of 14, drawn, set by hand, from 260, 180 to 380, 300"
        )
        for key in ("ArrowRight", "ArrowUp", "Shift+ArrowRight", "Shift+ArrowDown"):
            press(key)
        assert it.page.inner_text("#spoken").endswith("from 261, 179 to 382, 300")
        press("Tab")
        press("ArrowLeft")
        it.page.wait_for_selector("#saving.waiting")
        with server(labels, port=port):
            it.kept()
            store = LabelStore(labels)
            first, drawn = store.labels()
            assert (first.box, first.place) == (0, pytest.approx((19, 20, 139, 140)))
            assert drawn.place == pytest.approx((261, 179, 382, 300), abs=0.5)
            assert len(store.disputes()) == 0
            it.page.keyboard.press("x")
            it.kept()
            assert [label.box for label in store.labels()] == [drawn.box]


def test_disagreements_of_labellers_can_be_stepped_through(browser, tmp_path):
    labels = tmp_path / "labels.sqlite"
    with server(labels) as (url, _), opened(browser, url) as ann, opened(browser, url) as bob:
        for page, name in ((ann, "ann"), (bob, "bob")):
            page.page.fill("#who", name)
            page.page.locator("#who").press("Tab")
        ann.page.click("#frames li:nth-child(3) button")
        ann.frame(3)
        ann.click(200, 100)
        ann.click(350, 100)
        ann.kept()
        # Keys typed as a name are no commands: nothing else was marked.
        assert {label.box for label in LabelStore(labels).labels()} == {1, 2}
        bob.page.click("#frames li:nth-child(3) button")
        bob.frame(3)
        bob.page.wait_for_selector("#undo:disabled")
        bob.page.mouse.move(*bob.point(200, 100))
        bob.page.wait_for_selector('#tip:text-matches("marked as false, by ann")')
        bob.click(200, 100)
        bob.page.wait_for_selector('#dispute:text-is("1 disagreement (D)")')
        bob.page.click("#previous")
        bob.frame(2)
        bob.page.keyboard.press("d")
        bob.frame(3)
        bob.page.wait_for_selector('#notice:text-is("ann: false · bob: true")')
        # The last mark counts; who agrees after all ends it.
        assert LabelStore(labels).labels() == [Label(3, 2, "false")]
        bob.page.keyboard.press("x")
        bob.page.wait_for_selector("#dispute", state="hidden")
        assert [label.who for label in LabelStore(labels).labels()] == ["bob", "ann"]


def test_only_enter_finishes_a_frame_and_undo_takes_it_back(it, store):
    press = it.page.keyboard.press
    for key, number in (("ArrowRight", 2), ("ArrowRight", 3), ("ArrowLeft", 2)):
        press(key)
        it.frame(number)
    it.page.click("#next")
    it.frame(3)
    it.kept()
    assert store.progress().done == 0
    it.click(200, 60)
    press("Enter")
    it.frame(4)
    it.kept()
    assert dict(store.frames())[3]
    # Nothing was done on the next frame: what is undone is the finish, and the page shows where.
    press("z")
    it.frame(3)
    it.page.wait_for_selector('#progress:text-matches("^0 of 40 frames · 1 false")')
    it.kept()
    assert (store.progress().done, store.labels()) == (0, [Label(3, 1, "false")])
    assert "done" not in it.page.locator("#frames button").nth(2).get_attribute("class")
    press("y")
    it.page.wait_for_selector('#progress:text-matches("^1 of 40 frames")')
    # Another day it is the last that was done on that frame, before its marks.
    it.page.reload()
    it.ready()
    for _ in range(2):
        press("ArrowRight")
    it.frame(3)
    press("z")
    it.page.wait_for_selector('#progress:text-matches("^0 of 40 frames · 1 false")')
    press("z")
    it.page.wait_for_selector('#progress:text-matches("^0 of 40 frames · 0 false")')


def test_steps_count_while_a_frame_is_on_its_way(it):
    """A slow server: four presses at once are four frames, and back from there is the third."""
    it.page.route("**/api/frame/*", lambda route: (time.sleep(0.2), route.continue_()))
    for _ in range(4):
        it.page.keyboard.press("ArrowRight")
    it.frame(5)
    it.page.keyboard.press("ArrowLeft")
    it.frame(4)
    # A frame that does not come moves nothing: the next press asks for the same one again.
    it.page.unroute("**/api/frame/*")
    it.page.route("**/api/frame/8?*", lambda route: route.abort())
    for key, number in (("ArrowRight", 5), ("ArrowRight", 6), ("ArrowRight", 7)):
        it.page.keyboard.press(key)
        it.frame(number)
    it.page.keyboard.press("ArrowRight")
    it.page.wait_for_selector('#notice:text-matches("did not come from the server")')
    it.page.unroute("**/api/frame/8?*")
    it.page.keyboard.press("ArrowRight")
    it.frame(8)


def test_undo_lasso_and_all_like_this(it, store):
    it.page.mouse.move(*it.point(200, 100))
    it.page.wait_for_selector(f'#alike:text-is("all {FRAMES} like this (A)")')
    it.page.keyboard.press("a")
    it.kept()
    assert len(store.labels()) == FRAMES
    it.page.keyboard.press("z")
    it.page.wait_for_selector("#redo:enabled")
    it.kept()
    assert store.labels() == []
    it.page.mouse.move(*it.point(5, 5))
    it.page.mouse.down()
    for corner in ((320, 5), (320, 160), (5, 160), (5, 5)):
        it.page.mouse.move(*it.point(*corner), steps=4)
    it.page.mouse.up()
    it.kept()
    assert {label.box for label in store.labels()} == {0, 1, 12}
    it.page.keyboard.press("w")
    it.page.wait_for_selector("#wall button.false")
    it.page.locator("#wall button").nth(5).click()
    it.kept()
    assert {label.box for label in store.labels()} == {0, 1, 5, 12}


def test_births_are_marked_on_the_clip_about_a_frame(it, store):
    press = it.page.keyboard.press
    it.page.click("#frames li:nth-child(15) button")
    it.frame(15)
    assert "one leg" in it.page.inner_text("#rule-false")
    press("2")
    assert (it.page.is_visible("#rule-false"), it.page.is_visible("#rule-birth")) == (False, True)
    it.page.wait_for_selector('#when:text-is("frame 15, drawn")')
    press(".")
    press(".")
    it.page.wait_for_selector('#when:text-is("frame 17 (+2)")')
    it.click(200, 100)
    it.kept()
    assert store.labels() == [Label(17, 1, "birth")]
    assert "0 false · 1 birth" in it.page.inner_text("#progress")
    # On the first frame of the clip nobody can be told to be new.
    for _ in range(20):
        press(",")
    it.page.wait_for_selector('#when:text-is("frame 5 (−10)")')
    it.click(200, 100)
    it.page.wait_for_selector('#notice:text-matches("may have been there before")')
    # False boxes belong to the drawn frame: the key for them goes back there.
    press("1")
    it.page.wait_for_selector("#clip", state="hidden")
    it.click(350, 100)
    it.kept()
    assert store.labels() == [Label(15, 2, "false"), Label(17, 1, "birth")]
    # What is undone on a drawn frame may be a mark on another one of its clip.
    press("z")
    press("z")
    it.page.wait_for_selector("#undo:disabled")
    it.kept()
    assert store.labels() == []
    press("y")
    it.kept()
    it.page.wait_for_selector('#progress:text-matches(" 1 birth$")')
    assert store.labels() == [Label(17, 1, "birth")]
    press("2")
    press(" ")
    it.page.wait_for_selector('#play:text-is("❚❚")')
    it.page.wait_for_selector('#when:text-matches(" .−[0-9]")')
    # Round and round, one timer at a time.
    it.page.wait_for_selector('#when:text-matches(" .\\+[0-9]")')
    it.page.wait_for_selector('#when:text-matches(" .−[0-9]")')
    press(" ")
    it.page.wait_for_selector('#play:text-is("▶")')


def test_a_sweep_of_suggestions_is_confirmed_and_undone_at_once(it, store):
    it.page.wait_for_selector('#sweep-button:text-is("60 suggestions (S)")')
    it.page.keyboard.press("s")
    # What scores below is shown, and not ticked.
    it.page.wait_for_selector('#sweep-confirm:text-is("mark 50 of 60 as false (Enter)")')
    titles = it.page.locator("#sweep h2").all_inner_texts()
    assert titles[0].startswith("A place with too many detections, on 40 of the frames (40)")
    assert titles[1].startswith("Rejected by the filter as false alarms (20)")
    it.page.locator("#sweep .crops button").nth(7).click()
    it.page.locator("#sweep .crops button").nth(59).click()
    it.page.locator("#sweep .crops button").nth(58).click()
    it.page.wait_for_selector('#sweep-confirm:text-is("mark 51 of 60 as false (Enter)")')
    assert store.labels() == []
    it.page.keyboard.press("Enter")
    it.page.wait_for_selector('#progress:text-matches(" 51 false")')
    it.kept()
    marks = store.labels()
    assert {label.mark for label in marks} == {"false"}
    assert {label.frame for label in marks if label.box == 3} == set(range(1, FRAMES + 1)) - {8}
    assert {label.frame for label in marks if label.box == 4} == {*range(1, 20, 2), 37, 39}
    it.page.wait_for_selector('#sweep-button:text-is("9 suggestions (S)")')
    # What was done stays to be read, whatever the server answers and the mouse passes over, until
    # the next key or click.
    said = "51 boxes were marked as false; Z on this frame undoes it"
    it.page.mouse.move(*it.point(200, 100))
    it.page.wait_for_selector('#tip:text-matches("score 0.5")')
    it.page.wait_for_timeout(600)
    assert it.page.inner_text("#notice") == said
    # None of the frames has been looked at by that.
    assert store.progress().done == 0
    it.page.keyboard.press("z")
    it.page.wait_for_selector('#sweep-button:text-is("60 suggestions (S)")')
    assert store.labels() == []
    assert it.page.inner_text("#notice") == "taken back; Y does it again"
    it.page.keyboard.press("s")
    it.page.locator("#sweep h2 button").first.click()
    it.page.wait_for_selector('#sweep-confirm:text-is("mark 52 of 60 as false (Enter)")')
    it.page.locator("#sweep h2 button").first.click()
    it.page.wait_for_selector('#sweep-confirm:text-is("mark 12 of 60 as false (Enter)")')
    it.page.keyboard.press("Escape")
    it.page.wait_for_selector("#sweep", state="hidden")
    assert store.labels() == []


def test_what_is_heard_and_how_the_picture_is_left(it):
    press = it.page.keyboard.press

    def spoken() -> str:
        return it.page.inner_text("#spoken")

    assert spoken() == "1 of 40: frame 1, 13 boxes"
    # What the mouse passes over is shown only.
    it.page.mouse.move(*it.point(200, 100))
    it.page.wait_for_selector('#tip:text-matches("score 0.5")')
    assert spoken() == "1 of 40: frame 1, 13 boxes"
    it.page.mouse.move(*it.point(1, 1))
    press("Tab")
    assert spoken() == "box 1 of 13, score 0.5, no mark"
    press("x")
    assert spoken() == "box 1 of 13, score 0.5, marked as false"
    press("Enter")
    it.frame(2)
    it.kept()
    finished = it.page.get_by_label("frame 1 of 40, done", exact=True)
    assert finished.inner_text() == "✓"
    assert it.page.get_by_label("frame 2 of 40", exact=True).get_attribute("aria-current") == "true"
    focused = "document.activeElement.id"
    press("Tab")
    assert it.page.evaluate(focused) == "canvas"
    press("Escape")
    assert it.page.evaluate(focused) == "previous"
    press("Tab")
    assert it.page.evaluate(focused) == "next"


# Notes how long each picture takes to draw, until its pixels are there, in milliseconds.
TIMED = """
window.painted = [];
const next = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (paint) => next((time) => {
  const begun = performance.now();
  paint(time);
  document.getElementById("canvas").getContext("2d").getImageData(0, 0, 1, 1);
  painted.push(performance.now() - begun);
});
"""


def test_a_click_among_a_thousand_boxes_is_drawn_at_once(browser, tmp_path):
    rng = np.random.default_rng(0)
    corner = rng.uniform(0, 400, (1000, 2))
    size = rng.uniform(15, 80, (1000, 2))
    boxes = np.hstack([corner, corner + size, np.full((1000, 1), 0.5)]).round(2).tolist()
    with server(tmp_path / "labels.sqlite", boxes=1000) as (url, _):
        page = Page(browser.new_page(viewport=VIEWPORT))
        page.page.add_init_script(TIMED)
        # Boxes that overlap: they are the slowest to draw.
        page.page.route(
            "**/api/frame/1",
            lambda route: route.fulfill(json=route.fetch().json() | {"boxes": boxes}),
        )
        page.open(url)
        for x, y in rng.uniform(50, 400, (15, 2)):
            page.click(x, y)
            page.page.wait_for_timeout(60)
        took = page.page.evaluate("painted")
        assert len(took) >= 15
        assert np.median(took) < 50
        page.kept()
        page.page.close()


def test_the_page_does_not_wait_for_suggestions(browser, tmp_path):
    go = tmp_path / "go"
    with server(tmp_path / "labels.sqlite", waiting_for=go) as (url, _), opened(browser, url) as it:
        it.page.wait_for_selector('#sweep-button:text-is("suggestions … 25 %")')
        # The key does nothing yet, and what is clicked meanwhile is kept, and not suggested any
        # more.
        it.page.keyboard.press("s")
        assert it.page.locator("#sweep").is_hidden()
        it.click(500, 100)
        it.kept()
        go.touch()
        it.page.wait_for_selector('#sweep-button:text-is("59 suggestions (S)")')
        assert "1 false" in it.page.inner_text("#progress")


def test_no_click_is_lost_when_the_server_is_killed(browser, tmp_path):
    labels = tmp_path / "labels.sqlite"
    with server(labels) as (url, process), opened(browser, url) as it:
        port = int(url.rsplit(":", 1)[1].strip("/"))
        it.click(200, 100)
        it.kept()
        process.kill()
        process.wait()
        it.click(350, 100)
        it.click(500, 100)
        it.page.keyboard.press("z")
        it.click(60, 250)
        it.page.wait_for_selector("#saving.waiting")
        # Even if the page is closed meanwhile: what waits is in the browser.
        with server(labels, port=port):
            it.page.reload()
            it.ready()
            it.kept()
            assert {label.box for label in LabelStore(labels).labels()} == {1, 2, 4}


def test_no_click_of_two_tabs_is_lost_when_the_server_is_killed(context, tmp_path):
    labels = tmp_path / "labels.sqlite"
    with server(labels) as (url, process), opened(context, url) as one:
        port = int(url.rsplit(":", 1)[1].strip("/"))
        with opened(context, url) as other:
            process.kill()
            process.wait()
            one.click(200, 100)
            other.click(350, 100)
            one.click(500, 100)
            other.click(60, 250)
            other.page.wait_for_selector('#saving:text-matches("4 to be saved")')
        # The other one is closed before the server is back. What an earlier version left is taken,
        # too.
        left = [
            {
                "frame": 2,
                "what": "marks",
                "body": {"marks": [{"frame": 2, "box": 5, "mark": "false"}], "key": "old"},
            }
        ]
        one.page.evaluate(
            "left => localStorage.setItem('phdtrack-label:drawn', JSON.stringify(left))", left
        )
        with server(labels, port=port), opened(context, url) as third:
            for page in (one, third):
                page.kept()
            third.page.wait_for_selector('#progress:text-matches(" 5 false")')
            found = [(label.frame, label.box) for label in LabelStore(labels).labels()]
            assert found == [(1, 1), (1, 2), (1, 3), (1, 4), (2, 5)]
            assert one.page.evaluate("Object.keys(localStorage)") == ["phdtrack-who"]


def test_what_waits_is_not_sent_to_another_file_on_the_same_port(context, tmp_path):
    with server(tmp_path / "labels.sqlite") as (url, process), opened(context, url) as it:
        port = int(url.rsplit(":", 1)[1].strip("/"))
        process.kill()
        process.wait()
        it.click(200, 100)
        it.page.wait_for_selector("#saving.waiting")
        with server(tmp_path / "another.sqlite", port=port), opened(context, url) as another:
            another.click(350, 100)
            another.kept()
            it.page.wait_for_timeout(1500)
            assert [label.box for label in LabelStore(tmp_path / "another.sqlite").labels()] == [2]
        with server(tmp_path / "labels.sqlite", port=port):
            it.kept()
            assert [label.box for label in LabelStore(tmp_path / "labels.sqlite").labels()] == [1]
