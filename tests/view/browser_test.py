#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tests the page of `relidar view` in headless Chromium: points, sensor pose, sensor model, traffic, and
the log.

    browser_test.py RELIDAR WORK_FOLDER

Exits with 77 (skipped) if chromium, its driver or python3-selenium is missing."""
import os
import subprocess

from browser_page import run_test   # before selenium: reports that it is missing
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

# Counts the pixels of a picture (PNG, base64) that are not white, black or gray. These
# are points and boxes.
COLOURED = """
const done = arguments[arguments.length - 1], image = new Image();
image.onload = () => {
  const canvas = new OffscreenCanvas(image.width, image.height), context = canvas.getContext('2d');
  context.drawImage(image, 0, 0);
  const { data } = context.getImageData(0, 0, image.width, image.height);
  let n = 0;
  for (let i = 0; i < data.length; i += 4)
    n += Math.max(data[i], data[i + 1], data[i + 2]) - Math.min(data[i], data[i + 1], data[i + 2]) > 80;
  done(n);
};
image.src = 'data:image/png;base64,' + arguments[0];"""
# Measures the longest time between two animation frames in ms, during two seconds.
LONGEST_PAUSE = """
const done = arguments[0], end = performance.now() + 2000;
let last = performance.now(), longest = 0;
(function tick(now) {
  longest = Math.max(longest, now - last); last = now;
  if (now < end) requestAnimationFrame(tick); else done(longest);
})(last);"""
FIRST_BLUE = 0xFF000000 | 235 << 16 | 111 << 8 | 31      # colour of the first actor, as RGBA bytes
SECOND_ORANGE = 0xFF000000 | 15 << 16 | 88 << 8 | 217
COPY_GREEN = 0xFF000000 | 107 << 16 | 150 << 8 | 18    # colour of the third actor: a copy in a street with two actors


def coloured_pixels(page, canvas):
    return page.driver.execute_async_script(COLOURED, canvas.screenshot_as_base64)


def shows_points(page):
    assert page.find("#image-size").text == "32 × 512", page.find("#image-size").text
    page.wait("more than 5,000 coloured pixels in the view", lambda: coloured_pixels(page, page.find("#view")) > 5_000)


def share_of_changes(before, after):
    return sum(a != b for a, b in zip(before, after)) / len(before) if len(before) == len(after) else 1.0


def moves(page):
    before = page.strip()
    page.type("#place-y", "2.5")
    page.wait("another image from 2.5 m to the left", lambda: share_of_changes(before, page.strip()) > 0.3)
    page.find("body").click()
    page.find("#view").send_keys("w")
    page.wait("a tap of W to drive half a metre", lambda: page.find("#place-x").get_attribute("value") == "0.5")
    for wrong in ("1e9", "1e95", "-99999", "123456"):
        page.type("#place-x", wrong)
        assert page.find("#place-x").get_attribute("value") == "0.5", f"{wrong} has moved the sensor"
        assert "out of range" in page.find("#sensor-hint").text
        page.wait("the place before the wrong number in the address", lambda: "place=0.5,2.5,0," in page.driver.current_url)
    page.type("#place-x", "2")
    assert page.find("#place-x").get_attribute("value") == "2"
    page.click("#reset-place")
    page.wait("the first image again", lambda: share_of_changes(before, page.strip()) < 0.01)


def changes_sensor(page, work):
    Select(page.find("#sensor")).select_by_value("VLP-16")
    page.wait("16 rows", lambda: page.find("#image-size").text.startswith("16 × "))
    (work / "beams.csv").write_text("elevation_deg\n5\n0\n-5\n")
    page.find("#sensor-file").send_keys(str(work / "beams.csv"))
    page.wait("3 rows of a file", lambda: page.find("#image-size").text.startswith("3 × "))
    (work / "bad.csv").write_text("elevation_deg,colour\n5,1\n")
    page.find("#sensor-file").send_keys(str(work / "bad.csv"))
    page.wait("what is wrong with a file", lambda: "bad.csv line 1: column 'colour' is unknown" in page.find("#sensor-hint").text)
    Select(page.find("#sensor")).select_by_value("native")
    page.wait("32 rows again", lambda: page.find("#image-size").text == "32 × 512")


def shows_channels(page):
    """Checks that a number is coloured between the ends of its range, and a vector as RGB."""
    Select(page.find("#colouring")).select_by_value("channel:incidence")
    page.wait("incidence in the legend", lambda: page.find("#legend-name").text == "incidence" and page.find("#legend-high").text == "1")
    of_incidence = page.strip()
    Select(page.find("#colouring")).select_by_value("channel:normal")
    page.wait("no ends of a vector", lambda: page.find("#legend-name").text == "normal" and page.find("#legend-high").text == "")
    of_normal = page.strip()
    ground = [(p & 255, p >> 8 & 255, p >> 16 & 255) for p in of_normal[-512:] if p]
    upwards = sum(b > 230 and abs(r - 127) < 40 and abs(g - 127) < 40 for r, g, b in ground) / len(ground)
    assert upwards > 0.8, f"{upwards} of what the lowest beam meets faces upwards, expected the ground"
    assert len(set(of_incidence)) > 50 and share_of_changes(of_incidence, of_normal) > 0.5


def shows_weather(page):
    """Checks that points of fog have the second colour of integers, and points of surfaces the first."""
    Select(page.find("#colouring")).select_by_value("channel:source")
    page.wait("no channel in clear air", lambda: page.strip().count(FIRST_BLUE) == 0)
    page.type("#weather", "fog=20\n")
    page.wait("fog", lambda: page.strip().count(FIRST_BLUE) > 1_000 and page.strip().count(SECOND_ORANGE) > 1_000)
    page.wait("the weather in the address", lambda: "weather=fog" in page.driver.current_url)
    page.type("#weather", "fog=0\n")
    page.wait("what is wrong with a weather", lambda: "found fog=0, expected a visibility" in page.find("#message").text)
    page.type("#weather", "clear\n")
    page.wait("clear air again", lambda: page.strip().count(FIRST_BLUE) == 0)


def edits(page, relidar, work):
    Select(page.find("#colouring")).select_by_value("instance")
    page.wait("the first actor in the image", lambda: page.strip().count(FIRST_BLUE) > 0)
    buttons = ".actor[data-track='0'] button"
    page.click(f"{buttons}:nth-of-type(1)")
    page.wait("the first actor hidden", lambda: page.strip().count(FIRST_BLUE) == 0)
    page.click(f"{buttons}:nth-of-type(1)")
    page.wait("the first actor back", lambda: page.strip().count(FIRST_BLUE) > 0)
    page.click(f"{buttons}:nth-of-type(2)")
    page.wait("a copy in the list and in the image",
              lambda: page.driver.find_elements(By.CSS_SELECTOR, ".actor[data-track='0-copy-1']") and page.strip().count(COPY_GREEN) > 0)
    page.click(f"{buttons}:nth-of-type(3)")
    page.wait("the first actor removed", lambda: page.strip().count(FIRST_BLUE) == 0 and page.strip().count(COPY_GREEN) > 0)
    page.type("#save-name", "edited")
    page.driver.execute_script("document.querySelector('aside').scrollTop = 0; document.getElementById('save').click()")
    page.wait("the edited run saved", lambda: "saved as" in page.find("#save-hint").text)
    below = page.driver.execute_script("return document.getElementById('save-hint').getBoundingClientRect().bottom - innerHeight")
    assert below < 1, f"the answer is {below} pixels below the window"
    info = subprocess.run([relidar, "info", str(work / "saved/edited")], capture_output=True, text=True, check=True).stdout
    assert "--copy 0@" in info and "--remove 0" in info, info
    page.click("#save")
    page.wait("a second run of that name refused", lambda: "already exists" in page.find("#save-hint").text)


def shows_the_log(page):
    page.wait("the log read", lambda: page.find("[data-mode='both']").is_enabled())
    Select(page.find("#colouring")).select_by_value("range")
    page.click("[data-mode='both']")
    page.wait("the real image", lambda: page.find("#real-strip").is_displayed() and sum(p != 0 for p in page.strip("real-strip")) > 10_000)
    page.click("[data-mode='simulated']")


def stays_responsive(page):
    before = page.find("#time").get_attribute("value")
    page.click("#play")
    page.wait("time going on", lambda: page.find("#time").get_attribute("value") != before)
    pause_ms = page.driver.execute_async_script(LONGEST_PAUSE)
    print(f"longest pause of the page while it plays: {pause_ms:.0f} ms")
    assert pause_ms < 1000, pause_ms


def serves_two_tabs(page, url):
    first = page.driver.current_window_handle
    page.driver.switch_to.new_window("tab")
    page.driver.get(url)
    page.wait("points in a second tab", lambda: page.points() > 10_000)
    assert len(page.driver.find_elements(By.CSS_SELECTOR, ".actor")) == 2, "the other tab's copy is not this one's"
    page.driver.switch_to.window(first)
    page.wait("points in the first", lambda: page.points() > 10_000)


def shows_a_report(page, relidar, work):
    command = [relidar, "eval", "run", "--out", "scored/metrics.json", "--open", "--quiet"]
    subprocess.run(command, cwd=work, check=True, env=dict(os.environ, PATH=str(work / "no_browser")))
    file = work / "scored/evaluation.html"
    assert file.stat().st_size < 8e6, file.stat().st_size
    page.driver.get(file.as_uri())
    clouds = lambda: page.driver.find_elements(By.CSS_SELECTOR, ".pair canvas")
    page.wait("two clouds", lambda: len(clouds()) == 2 and all(coloured_pixels(page, canvas) > 3_000 for canvas in clouds()))
    pictures = [canvas.screenshot_as_base64 for canvas in clouds()]
    page.find(".pair canvas").send_keys(Keys.ARROW_LEFT)
    page.wait("both clouds turned by an arrow key",
              lambda: all(a != canvas.screenshot_as_base64 for a, canvas in zip(pictures, clouds())))


def check(page, viewer, relidar, work):
    shows_points(page)
    moves(page)
    changes_sensor(page, work)
    shows_channels(page)
    shows_weather(page)
    edits(page, relidar, work)
    shows_the_log(page)
    stays_responsive(page)
    serves_two_tabs(page, viewer.url)
    shows_a_report(page, relidar, work)
    page.driver.get(viewer.url)
    page.wait("points after the report", lambda: page.points() > 10_000)
    assert page.errors() == [], page.errors()
    viewer.end()
    page.wait("the page to say that the program has ended", lambda: "has ended" in page.find("#message").text)


run_test(check, "--channels", "normal,incidence")
print("the page does what it should")
