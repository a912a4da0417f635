"""Chromium, driven through chromedriver (WebDriver), with nothing but Python's own library."""

import base64
import json
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
from pathlib import Path

ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
# WebGL without a graphics card.
FLAGS = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle",
         "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars"]


class Failed(Exception):
    """The browser refused, or what was waited for did not come."""


class Browser:
    def __init__(self, width, height, dark=False):
        driver = shutil.which("chromedriver")
        if driver is None:
            raise Failed("there is no chromedriver: apt-get install chromium chromium-driver")
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.process = subprocess.Popen([driver, f"--port={port}", "--log-level=SEVERE"],
                                        stdout=subprocess.DEVNULL)
        self.base = f"http://127.0.0.1:{port}"
        self.wait(lambda: self.ask("GET", "/status")["ready"], "chromedriver", patience=60)
        flags = FLAGS + [f"--window-size={width},{height}"]
        capabilities = {"browserName": "chrome", "goog:chromeOptions": {"args": flags},
                        "goog:loggingPrefs": {"browser": "ALL"}}
        session = self.ask("POST", "/session", {"capabilities": {"alwaysMatch": capabilities}})
        self.base += f"/session/{session['sessionId']}"
        self.size(width, height)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.devtools("Emulation.setEmulatedMedia", features=[scheme])

    def ask(self, method, path, content=None):
        data = None if method == "GET" else json.dumps(content or {}).encode()
        request = urllib.request.Request(self.base + path, data, {"Content-Type": "application/json"},
                                         method=method)
        try:
            with urllib.request.urlopen(request, timeout=120) as response:
                return json.load(response)["value"]
        except urllib.error.HTTPError as error:
            value = json.load(error)["value"]
            raise Failed(f"{value['error']}: {value['message'].splitlines()[0]}") from None
        except urllib.error.URLError as error:
            raise Failed(str(error)) from None

    def devtools(self, command, **params):
        return self.ask("POST", "/goog/cdp/execute", {"cmd": command, "params": params})

    def size(self, width, height, phone=False):
        """Sets the size of what is shown, not of the window."""
        self.devtools("Emulation.setDeviceMetricsOverride", width=width, height=height,
                      deviceScaleFactor=2 if phone else 1, mobile=phone)
        self.devtools("Emulation.setTouchEmulationEnabled", enabled=phone)

    def open(self, url):
        self.ask("POST", "/url", {"url": url})

    def js(self, code, *arguments):
        """What a function body returns, after its promise is kept."""
        wrapped = ("const done = arguments[arguments.length - 1];"
                   f"(async (...args) => {{ {code} }})(...arguments)"
                   ".then(done, (error) => done({ error: String(error) }));")
        value = self.ask("POST", "/execute/async", {"script": wrapped, "args": list(arguments)})
        if isinstance(value, dict) and set(value) == {"error"}:
            raise Failed(value["error"])
        return value

    def find(self, selector):
        return self.ask("POST", "/element", {"using": "css selector", "value": selector})[ELEMENT]

    def click(self, selector):
        """Waits for the element and clicks it; once more where the page put another in its place in between."""
        self.wait(lambda: self.ask("POST", f"/element/{self.find(selector)}/click") is None, f"{selector} to click")

    def choose(self, selector, value):
        """Sets a form control as a person would have."""
        self.js("const one = document.querySelector(args[0]); one.value = args[1];"
                "for (const kind of ['input', 'change']) one.dispatchEvent(new Event(kind, { bubbles: true }));",
                selector, value)

    def keys(self, *keys):
        held = [{"type": "keyDown", "value": key} for key in keys]
        let_go = [{"type": "keyUp", "value": key} for key in reversed(keys)]
        self.ask("POST", "/actions", {"actions": [{"type": "key", "id": "keys", "actions": held + let_go}]})

    def drag(self, *places, pointer="mouse"):
        """Presses at the first place of the page, goes over the others and lets go at the last."""
        move = [{"type": "pointerMove", "x": round(x), "y": round(y), "duration": 60} for x, y in places]
        actions = [move[0], {"type": "pointerDown", "button": 0}, *move[1:], {"type": "pointerUp", "button": 0}]
        source = {"type": "pointer", "id": pointer, "parameters": {"pointerType": pointer}, "actions": actions}
        self.ask("POST", "/actions", {"actions": [source]})

    def wait(self, condition, what, patience=60):
        end = time.monotonic() + patience
        while time.monotonic() < end:
            try:
                found = condition()
                if found:
                    return found
            except Failed:
                pass
            time.sleep(0.1)
        raise Failed(f"waited in vain for {what}")

    def until(self, code, what, patience=60):
        return self.wait(lambda: self.js(f"return {code};"), what, patience)

    def screenshot(self, path):
        Path(path).write_bytes(base64.b64decode(self.ask("GET", "/screenshot")))

    def complaints(self):
        """What the console was told since the last call that is more than a hint."""
        entries = self.ask("POST", "/se/log", {"type": "browser"})
        return [entry["message"] for entry in entries if entry["level"] in ("SEVERE", "WARNING")
                and "GPU stall due to ReadPixels" not in entry["message"]]

    def close(self):
        try:
            self.ask("DELETE", "")
        except Failed:
            pass
        self.process.terminate()
        self.process.wait(timeout=30)
