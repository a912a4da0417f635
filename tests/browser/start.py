"""From nothing to a scene, in the page of `tid3r view`: photos are dropped on it and become one, on made-up weights."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from browser import Browser, Failed

# Stand in for FFmpeg, so that videos take their time and need no FFmpeg.
FFPROBE = """#!/usr/bin/env python3
import sys
video = open(sys.argv[sys.argv.index("-i") + 1].removeprefix("file:"), "rb").read()
if b"broken" in video:
    sys.exit("moov atom not found")
print('{"streams": [{"duration": "40"}], "format": {}}')
"""
FFMPEG = """#!/usr/bin/env python3
import sys, time
if "-frames:v" in sys.argv:
    sys.stdout.buffer.write(b"P6 64 48 255\\n" + bytes(64 * 48 * 3))
    sys.exit()
for k in range(200):
    print(f"[Parsed_showinfo_3 @ 0x1] n: {k} pts: {k} pts_time:{k / 5}", file=sys.stderr, flush=True)
    sys.stdout.buffer.write(bytes(480 * 480))
    sys.stdout.buffer.flush()
    time.sleep(0.1)
"""
FILM = b"\0\0\0\x18ftypmp42\0\0\0\0mp42isom"


def check(condition, what):
    if not condition:
        raise Failed(what)


class Start:
    """The steps, in order."""

    def __init__(self, browser, url, folder, screenshots):
        self.browser, self.url, self.folder, self.screenshots = browser, url, folder, screenshots

    def shots(self, name):
        """By day and by night, on a desk and in a hand."""
        for scheme in ("light", "dark"):
            feature = {"name": "prefers-color-scheme", "value": scheme}
            self.browser.devtools("Emulation.setEmulatedMedia", features=[feature])
            for device, size in (("desk", (1280, 720)), ("phone", (390, 844))):
                self.browser.size(*size, phone=device == "phone")
                wide = self.browser.js("return document.documentElement.scrollWidth > innerWidth;")
                check(not wide, f"{name}: the page is wider than the {device}")
                time.sleep(0.3)
                self.browser.screenshot(self.screenshots / f"start_{name}_{scheme}_{device}.png")
        self.browser.size(1280, 720)

    def text(self, selector):
        return self.browser.js("return document.querySelector(args[0]).textContent;", selector)

    def drop(self, *names):
        """As if these files were chosen or dropped."""
        paths = "\n".join(str(self.folder / name) for name in names)
        field = self.browser.find("#chosen")
        self.browser.ask("POST", f"/element/{field}/value", {"text": paths})

    def press(self, selector):
        """With the keyboard."""
        self.browser.js("document.querySelector(args[0]).focus();", selector)
        self.browser.keys("\ue007")

    def arrived(self, count):
        self.browser.until(f"document.querySelectorAll('#files [data-upload]').length === {count}"
                           " && [...document.querySelectorAll('#files img')].every((one) => one.complete && one.naturalWidth)",
                           f"{count} files")

    def begin(self):
        self.browser.until("!document.querySelector('#begin').disabled", "the button")
        self.press("#begin")
        self.browser.until("document.querySelector('.job.running') && !document.querySelector('#making').hidden", "the job")

    def nothing_yet(self):
        self.browser.open(self.url)
        self.browser.until("document.querySelector('#folder')?.textContent", "the page")
        check(self.text("#folder") == str(self.folder / "room"), "another folder")
        check(self.browser.js("return document.querySelector('#begin').disabled;"), "nothing can become a scene")
        self.shots("empty")
        unnamed = self.browser.js("""
            return [...document.querySelectorAll("button, input, select, a")].filter((one) =>
                !(one.ariaLabel || one.textContent.trim() || one.labels?.length || one.title)).map((one) => one.outerHTML);""")
        check(not unnamed, f"controls without a name: {unnamed}")

    def refuse_and_remove(self):
        self.drop("letter.jpg", "photo_10.png", "photo_9.png")
        self.arrived(2)
        self.browser.until("document.querySelector('#files .refused')", "the refusal")
        check("letter.jpg is neither a photo" in self.text("#files .refused"), "why it was refused")
        names = self.browser.js("return [...document.querySelectorAll('#files [data-upload] > span')].map((one) => one.textContent);")
        check(names == ["photo_9.png", "photo_10.png"], f"the order is {names}")
        self.shots("refused")
        self.press("#files .refused button")
        self.press("#files [data-upload='2'] button")
        self.browser.until("document.querySelectorAll('#files li').length === 1", "two files gone")
        self.drop(*(f"photo_{k}.png" for k in range(1, 4)))
        self.arrived(4)
        self.shots("photos")

    def cancel(self):
        self.drop("walk.mp4")
        self.arrived(5)
        self.begin()
        self.browser.until("document.querySelector('.job p').textContent.includes('left')", "how long it takes")
        self.shots("running")
        self.press(".job .cancel")
        self.browser.until("!document.querySelector('#outcome').hidden", "the job cancelled")
        check("Cancelled" in self.text("#outcome"), "that it was cancelled")
        check(self.browser.js("return document.activeElement.id;") == "begin", "the focus is lost")

    def reload(self):
        self.begin()
        self.browser.open(self.url)
        self.browser.until("document.querySelector('.job.running .progress')?.ariaValueNow > 0", "the job, after reloading")
        check(self.browser.js("return document.querySelector('#drop').hidden;"), "files are taken meanwhile")
        self.arrived(5)
        self.press(".job .cancel")
        self.browser.until("!document.querySelector('#outcome').hidden", "the job cancelled again")

    def fail_and_try_again(self):
        self.press("#files [data-upload='6'] button")
        self.drop("broken.mp4")
        self.browser.until("document.querySelector('[data-upload=\"7\"]')", "the video")
        self.press("#begin")
        self.browser.until("document.querySelector('.job.failed')", "the failure")
        words = self.text(".job.failed")
        check("broken.mp4: is no video" in words and "convert it to MP4" in words, f"it says {words}")
        check(self.text("#begin") == "Try again", "it cannot be tried again")
        self.shots("failed")
        self.press("#files [data-upload='7'] button")
        self.arrived(4)

    def land_in_the_scene(self):
        self.begin()
        self.browser.until("window.tid3r?.state.scene && !tid3r.view.flight"
                           " && tid3r.state.loaded === tid3r.state.scene.points.count", "the scene", 600)
        scene = self.browser.js("return tid3r.state.scene;")
        check(len(scene["photos"]) == 4 and scene["instances"] and "not_editable" not in scene, "half a scene")
        check(scene["folder"] == str(self.folder / "room"), f"it is in {scene['folder']}")
        self.shots("scene")
        self.browser.open(self.url)
        self.browser.until("window.tid3r?.state.scene", "the scene, after reloading")

    STEPS = [nothing_yet, refuse_and_remove, cancel, reload, fail_and_try_again, land_in_the_scene]


def prepare(program, scene, folder):
    """Photos, films, made-up weights and stand-ins for FFmpeg."""
    pictures = sorted(scene.glob("frames/*/colour.png"))
    for k in range(1, 11):
        # The same picture twice would be refused.
        content = pictures[(k - 1) % len(pictures)].read_bytes()
        (folder / f"photo_{k}.png").write_bytes(content + bytes((k - 1) // len(pictures)))
    (folder / "letter.jpg").write_text("Dear reader")
    (folder / "walk.mp4").write_bytes(FILM)
    (folder / "broken.mp4").write_bytes(FILM + b"broken")
    for name, text in (("ffprobe", FFPROBE), ("ffmpeg", FFMPEG)):
        (folder / "bin").mkdir(exist_ok=True)
        (folder / "bin" / name).write_text(text)
        (folder / "bin" / name).chmod(0o755)
    subprocess.run([program, "weights", "synthesize", "mvdust3r", "--tiny", "-o", folder / "models/mvdust3r"],
                   check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def serve(program, folder, models):
    environment = {**os.environ, "TID3R_MODELS": str(folder / models), "HF_HOME": str(folder / "nothing"),
                   "PATH": f"{folder / 'bin'}:{os.environ['PATH']}"}
    # Where the program and its scene are is not where the test began.
    server = subprocess.Popen([program.resolve(), "view", "--port", "0"], cwd=folder, env=environment, text=True,
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    return server, server.stdout.readline().strip()


def end(server):
    server.send_signal(signal.SIGINT)
    check(server.wait(timeout=30) == 0, "the server ended badly")


def run(program, scene, screenshots):
    """All of it; `scene` lends its photos."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder).resolve()
        prepare(program, scene, folder)
        server, url = serve(program, folder, "nothing")
        browser = Browser(1280, 720)
        try:
            tour = Start(browser, url, folder, screenshots)
            browser.open(url)
            browser.until("!document.querySelector('#lacking').hidden", "what is lacking")
            check("weights convert" in tour.text("#lacking"), "what to do about it")
            tour.shots("no_weights")
            end(server)
            browser.complaints()
            server, url = serve(program, folder, "models")
            tour.url = url
            for step in Start.STEPS:
                start = time.monotonic()
                try:
                    step(tour)
                except Failed as error:
                    browser.screenshot(screenshots / "failed.png")
                    sys.exit(f"{step.__name__}: {error}\n{browser.complaints()}")
                print(f"{step.__name__:20} {time.monotonic() - start:6.1f} s", flush=True)
                # What is refused on purpose is told to the console, too.
                complaints = [one for one in browser.complaints() if "/api/uploads/" not in one]
                if complaints:
                    sys.exit(f"{step.__name__}: the console says {complaints}")
        finally:
            browser.close()
            if server.poll() is None:
                end(server)
