# SPDX-License-Identifier: Apache-2.0
"""Helpers for tests of the viewer's page: headless Chromium that displays it.

Exits with 77 (skipped) if chromium, its driver or python3-selenium is missing."""
import pathlib
import shutil
import sys
import time

try:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys
except ImportError:
    print("skipped: python3-selenium is missing (tools/dev/setup --tests)")
    sys.exit(77)

from viewer_process import PATIENCE_S, Viewer, train_street

STRIP = """const c = document.getElementById(arguments[0]);
return Array.from(new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer));"""


class Page:
    def __init__(self, url, work):
        self.work = work
        options = webdriver.ChromeOptions()
        for flag in ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--window-size=1280,860"]:
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
        self.driver.set_script_timeout(30)
        self.driver.get(url)

    def find(self, selector):
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def click(self, selector):
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'}); arguments[0].click()", self.find(selector))

    def type(self, selector, text):
        field = self.find(selector)
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", field)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(text)

    def strip(self, name="strip"):
        return self.driver.execute_script(STRIP, name)

    def points(self):
        text = self.find("#n-points").text.replace(",", "")
        return int(text) if text.isdigit() else 0

    def wait(self, what, condition):
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            if condition():
                return
            time.sleep(0.1)
        self.driver.save_screenshot(str(self.work / "failed.png"))
        raise AssertionError(f"waited {PATIENCE_S} s for: {what}; the page says: {self.find('#message').text!r}, errors: {self.errors()}")

    def errors(self):
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]


def run_test(check, *options):
    """Calls check(page, viewer, relidar, work) with a page that shows points of a trained street.

    options: of `relidar view`"""
    relidar, work = str(pathlib.Path(sys.argv[1]).resolve()), pathlib.Path(sys.argv[2]).resolve()
    for name in ("chromium", "chromedriver"):
        if shutil.which(name) is None:
            print(f"skipped: {name} is missing (tools/dev/setup --tests)")
            sys.exit(77)
    train_street(relidar, work)
    viewer, page = Viewer(relidar, work, "run", "--port", "0", *options), None
    try:
        page = Page(viewer.url, work)
        page.wait("more than 10,000 points", lambda: page.points() > 10_000)
        check(page, viewer, relidar, work)
    finally:
        viewer.kill()
        if page:
            page.driver.quit()
