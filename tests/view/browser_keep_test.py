#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tests driving and placing actors in the page of `relidar view`. The page must keep its state when it is
reloaded and when the program restarts.

    browser_keep_test.py RELIDAR WORK_FOLDER

Exits with 77 (skipped) if chromium, its driver or python3-selenium is missing."""
import re
import subprocess
from urllib.parse import unquote

from browser_page import run_test   # before selenium: reports that it is missing
from viewer_process import Viewer
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

SPEED_MPS = 5.0
FASTER = 4.0
# Records the times of the first press of W and of its release, from the page's events.
WATCH_W = """
window.wTimes = [];
for (const kind of ['keydown', 'keyup'])
  document.addEventListener(kind, (event) => { if (event.key.toLowerCase() === 'w' && !event.repeat) window.wTimes.push(event.timeStamp); });"""
# Calls back after two animation frames.
TWO_PICTURES = "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()));"
WARNS = "return !window.dispatchEvent(new Event('beforeunload', {cancelable: true}));"
CAR_HEIGHT_M = 0.825   # height of a car's centre above the flat ground of the street


def place(page):
    return [float(page.find(f"#place-{name}").get_attribute("value")) for name in ("x", "y", "z", "yaw", "pitch", "roll")]


def focused(page):
    return page.driver.switch_to.active_element.get_attribute("id")


def type_key(page, key):
    page.driver.switch_to.active_element.send_keys(key)


def reset_place(page):
    page.click("#reset-place")
    assert place(page) == [0, 0, 0, 0, 0, 0]


def lists_give_the_keys_back(page):
    Select(page.find("#sensor")).select_by_value("VLP-16")
    type_key(page, "w")
    page.wait("W to drive after a choice in a list", lambda: place(page)[0] == 0.5)
    assert page.find("#sensor").get_attribute("value") == "VLP-16", "W has chosen another sensor"
    page.driver.execute_script("arguments[0].focus()", page.find("#sensor"))
    type_key(page, Keys.ARROW_DOWN)
    chosen = page.find("#sensor").get_attribute("value")
    assert chosen != "VLP-16" and focused(page) == "sensor", "who goes through a list by its keys keeps it"
    type_key(page, Keys.ENTER)
    page.wait("Enter to end the choice", lambda: focused(page) == "view")
    assert page.find("#sensor").get_attribute("value") == chosen
    page.click("#show-grid")
    page.driver.execute_script("arguments[0].focus()", page.find("#show-grid"))
    type_key(page, "s")
    page.wait("S to drive from a checkbox", lambda: place(page)[0] == 0)
    page.click("#show-grid")
    page.type("#save-name", "wasd")
    page.driver.execute_async_script(TWO_PICTURES)
    assert place(page) == [0, 0, 0, 0, 0, 0] and page.find("#save-name").get_attribute("value") == "wasd", "text drives nothing"
    page.type("#place-y", "2" + Keys.ENTER)
    assert place(page)[1] == 2 and focused(page) == "view"
    Select(page.find("#sensor")).select_by_value("native")
    reset_place(page)


def held_s(page):
    pressed, released = page.driver.execute_script("return window.wTimes.splice(0)")
    return (released - pressed) / 1000


def drives_while_keys_are_down(page):
    page.driver.execute_script(WATCH_W)
    page.find("#view").click()
    for shift, speed, seconds in ((False, SPEED_MPS, 2), (True, FASTER * SPEED_MPS, 0.5)):
        keys = ActionChains(page.driver)
        if shift:
            keys.key_down(Keys.SHIFT)
        keys.key_down("w").pause(seconds).key_up("w")
        if shift:
            keys.key_up(Keys.SHIFT)
        keys.perform()
        page.driver.execute_async_script(TWO_PICTURES)
        seconds = held_s(page)
        x = place(page)[0]
        print(f"{x} m in {seconds:.3f} s")
        assert abs(x - speed * seconds) < 0.01, f"{x} m in {seconds} s, expected {speed} m/s"
        page.driver.execute_async_script(TWO_PICTURES)
        assert place(page)[0] == x, "it drives on with no key down"
        reset_place(page)
    ActionChains(page.driver).key_down("w").perform()
    page.wait("W to drive", lambda: place(page)[0] > 0.2)
    page.driver.execute_script("window.dispatchEvent(new Event('blur'))")
    page.driver.execute_async_script(TWO_PICTURES)
    x = place(page)[0]
    page.driver.execute_async_script(TWO_PICTURES)
    assert place(page)[0] == x, "it drives on in a window that has lost the keyboard"
    ActionChains(page.driver).key_up("w").perform()
    reset_place(page)


def rows(page):
    return page.driver.execute_script("return [...document.querySelectorAll('.actor')].map((row) => row.dataset.track)")


def click_on_view(page, right, down):
    """Clicks at an offset in pixels from the centre of the view."""
    view = page.find("#view")
    page.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", view)
    ActionChains(page.driver).move_to_element_with_offset(view, right, down).click().perform()


def start_of(relidar, run, track):
    text = subprocess.run([relidar, "info", str(run)], capture_output=True, text=True, check=True).stdout
    found = re.search(rf"^ *{track} .* (\S+,\S+,\S+,\S+) +\d+ +\d+$", text, re.MULTILINE)
    assert found, text
    return [float(v) for v in found[1].split(",")]


def places_actors_on_the_ground(page, relidar, work):
    page.click(".actor[data-track='0'] button:nth-of-type(4)")
    assert "placing" in page.find("#view").get_attribute("class")
    click_on_view(page, 0, -240)   # a point above the horizon
    page.wait("a click into the sky refused", lambda: "sky" in page.find("#save-hint").text or "no surface" in page.find("#save-hint").text)
    click_on_view(page, 60, 60)
    page.wait("a copy where the click was", lambda: rows(page) == ["0", "1", "0-copy-1"])
    assert page.find("#view").get_attribute("class") == "", "one click places one"
    page.click("#insert-place")
    click_on_view(page, -60, 60)
    page.wait("an actor of the other run", lambda: rows(page) == ["0", "1", "0-copy-1", "0-insert-1"])
    page.click("#insert-place")
    page.find("#view").send_keys(Keys.ESCAPE)
    assert page.find("#view").get_attribute("class") == "", "Esc to cancel"
    page.driver.save_screenshot(str(work / "placed.png"))
    assert page.driver.execute_script(WARNS), "no warning before edits are lost"
    page.type("#save-name", "placed")
    page.click("#save")
    page.wait("the edited run saved", lambda: "saved as" in page.find("#save-hint").text)
    assert not page.driver.execute_script(WARNS), "a warning though the edits are saved"
    copy, insert = (start_of(relidar, work / "saved/placed", track) for track in ("0-copy-1", "0-insert-1"))
    for at in (copy, insert):
        assert abs(at[2] - CAR_HEIGHT_M) < 0.05, at
    assert copy[1] < insert[1] - 1, f"right of the middle and left of it: {copy}, {insert}"


def survives_a_reload(page):
    Select(page.find("#sensor")).select_by_value("VLP-16")
    page.type("#place-y", "1.5")
    page.type("#place-yaw", "20")
    Select(page.find("#colouring")).select_by_value("instance")
    page.click("[data-camera='orbit']")
    page.click("#show-boxes")
    page.click("#forth")
    page.click(".actor[data-track='1'] button:nth-of-type(3)")
    time_text = page.find("#time-text").text
    page.wait("the address to tell all", lambda: all(
        part in unquote(page.driver.current_url)
        for part in ("sensor=VLP-16", "place=0,1.5,0,20,0,0", "colour=instance", "camera=orbit", '"removed":["1"]')))
    page.driver.refresh()
    page.wait("points after a reload", lambda: page.points() > 5_000)
    page.wait("the edits after a reload", lambda: rows(page) == ["0", "1", "0-copy-1", "0-insert-1"])
    assert page.find("#sensor").get_attribute("value") == "VLP-16" and page.find("#image-size").text.startswith("16 × ")
    assert place(page) == [0, 1.5, 0, 20, 0, 0], place(page)
    assert page.find("#time-text").text == time_text
    assert page.find("#colouring").get_attribute("value") == "instance"
    assert page.find("[data-camera='orbit']").get_attribute("aria-pressed") == "true"
    assert not page.find("#show-boxes").is_selected()
    assert "gone" in page.find(".actor[data-track='1']").get_attribute("class")
    assert not page.find("#note").is_displayed(), page.find("#note").text


def goes_on_after_a_restart(page, relidar, work, viewer):
    port = viewer.url.rstrip("/").rsplit(":", 1)[1]
    page.click("#show-boxes")
    viewer.end()
    page.wait("the page to say that the program has ended", lambda: "Trying again" in page.find("#message").text)
    page.type("#place-y", "-2.5")   # changes the field while no program is running
    viewer = Viewer(relidar, work, "run", "--insert", "run", "--port", port)
    try:
        page.wait("the page to go on", lambda: page.find("#message").text == "")
        before = page.strip()
        assert place(page) == [0, -2.5, 0, 20, 0, 0] and page.find("#sensor").get_attribute("value") == "VLP-16"
        assert rows(page) == ["0", "1", "0-copy-1", "0-insert-1"] and page.find("#show-boxes").is_selected()
        page.click("#reset-place")
        page.wait("scans of the program that is new", lambda: page.strip() != before)
        viewer.end()
        viewer = Viewer(relidar, work, "saved/placed", "--port", port)
        page.wait("another run to be noticed", lambda: "now shows the run placed instead of run" in page.find("#note").text)
        page.wait("the other run without the edits", lambda: page.find("#message").text == "" and page.points() > 5_000)
        page.driver.save_screenshot(str(work / "another_run.png"))
        assert "gone" not in page.find(".actor[data-track='1']").get_attribute("class")
    finally:
        viewer.kill()


def understands_addresses(page, url):
    page.driver.get("about:blank")
    page.driver.get(url + "#sensor=VLP-16&place=1,2&colour=height&speed=3")
    page.wait("points of the address's sensor", lambda: page.points() > 5_000)
    note = page.find("#note").text
    assert "place=1,2" in note and "speed=3" in note and "\n" not in note.strip("×\n"), note
    assert page.find("#sensor").get_attribute("value") == "VLP-16" and page.find("#colouring").get_attribute("value") == "height"
    assert place(page) == [0, 0, 0, 0, 0, 0]
    page.click("#note-close")
    page.driver.execute_script("location.hash = '#run=0000&place=1,2,3,0,0,0'")
    page.wait("the address another run refused", lambda: "another run" in page.find("#note").text)
    assert place(page) == [0, 0, 0, 0, 0, 0]
    wrong = '{"copies":[{"of":"nobody","from":"","at":[0,0,0,0,0,0,0]}],"moves":{},"removed":[],"hidden":[]}'
    page.driver.execute_script("location.hash = '#edits=' + encodeURIComponent(arguments[0])", wrong)
    page.wait("edits that fit no run taken back", lambda: "was undone" in page.find("#note").text and "nobody" in page.find("#note").text)
    page.wait("scans all the same", lambda: page.find("#message").text == "" and rows(page) == ["0", "1"])
    page.click("#note-close")


def check(page, viewer, relidar, work):
    understands_addresses(page, viewer.url)
    page.driver.get("about:blank")
    page.driver.get(viewer.url)
    page.wait("points", lambda: page.points() > 10_000)
    lists_give_the_keys_back(page)
    drives_while_keys_are_down(page)
    places_actors_on_the_ground(page, relidar, work)
    survives_a_reload(page)
    assert page.errors() == [], page.errors()   # from here on, a stopped program causes errors
    goes_on_after_a_restart(page, relidar, work, viewer)


run_test(check, "--insert", "run")
print("the page keeps what it should")
