"""Headless Chromium, driven through ChromeDriver, for the tests of HTML pages."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.ui import WebDriverWait

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")

WAIT_S = 60


@contextmanager
def open_browser() -> Iterator[webdriver.Chrome]:
    """A browser with a window in which several plots are in sight."""
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM or ""
    for argument in ("--headless=new", "--no-sandbox", "--window-size=1200,1600"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options, Service(DRIVER))
    try:
        yield browser
    finally:
        browser.quit()


def drawn(browser: webdriver.Chrome, times: int = 1) -> None:
    """Wait until the plots were drawn this often."""
    script = f"return Number(document.documentElement.dataset.drawn || 0) >= {times}"
    WebDriverWait(browser, WAIT_S, 0.02).until(lambda one: one.execute_script(script))
