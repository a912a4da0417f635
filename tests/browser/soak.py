"""Edits at random in the page for as long as one likes: it shows what the server has, and neither of them grows."""

import random
import time
from pathlib import Path

from browser import Failed

# Edits after which all are undone, one by one.
MOST_EDITS = 25
# Actions between two looks at memory.
SPELL = 40


class Soak:
    def __init__(self, tour, server, seed):
        self.tour, self.browser, self.server = tour, tour.browser, server
        self.random = random.Random(seed)
        self.done = {}

    def settle(self, what):
        self.tour.shown("true", what)

    def count(self, what):
        """How many edits or instances there are."""
        return self.browser.js(f"return tid3r.state.scene.{what}.length;")

    def memory(self):
        """Megabytes that the page's objects and the server take."""
        self.browser.devtools("HeapProfiler.collectGarbage")
        page = self.browser.js("return performance.memory.usedJSHeapSize;") / 1e6
        status = Path(f"/proc/{self.server.pid}/status").read_text()
        kilobytes = next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS"))
        return page, int(kilobytes) / 1e3

    def pick(self):
        # Few places: chromedriver keeps in the page whatever scripts return.
        hits = self.tour.visible(most_size=3.0, most_places=12)
        if not hits:
            self.browser.keys("0")
            self.settle("all of the room")
            return None
        id = self.random.choice(sorted(hits))
        self.tour.click_at(self.random.choice(hits[id]))
        if self.tour.selected() != [id]:
            raise Failed(f"a click on {id} selects {self.tour.selected()}")
        return self.random.choice(hits[id])

    def remove(self):
        if self.count("instances") > 4 and self.pick():
            self.browser.click("#do-remove")

    def duplicate(self):
        if self.pick():
            self.browser.click("#do-duplicate")

    def recolour(self):
        if self.pick():
            self.browser.choose("#colour", "#%06x" % self.random.randrange(1 << 24))

    def rename(self):
        if self.pick():
            self.browser.choose("#rename", f"Object {self.random.randrange(1000)}")

    def move(self):
        self.browser.keys("3")
        self.settle("the map")
        if place := self.pick():
            by = [self.random.randint(-80, 80), self.random.randint(-60, 60)]
            self.browser.drag(place, [place[0] + by[0] / 2, place[1] + by[1] / 2], [place[0] + by[0], place[1] + by[1]])
            self.settle("the move")
        self.browser.keys("1")

    def undo(self):
        if self.count("edits"):
            self.browser.keys("\ue009", "z")

    def redo(self):
        if not self.browser.js("return document.querySelector('#redo').disabled;"):
            self.browser.keys("\ue009", "\ue008", "z")

    def look(self):
        self.browser.keys(self.random.choice("012c"))

    ACTIONS = [remove, duplicate, recolour, rename, move, undo, undo, redo, look]

    def agree(self):
        """The page shows the edits and objects that the server has."""
        same = self.browser.js("const scene = await (await fetch('/api/scene')).json();"
                               "return JSON.stringify(scene) === JSON.stringify(tid3r.state.scene);")
        if not same:
            raise Failed("the page shows another scene than the server has")

    def undo_all(self):
        while before := self.count("edits"):
            self.browser.keys("\ue009", "z")
            self.tour.shown(f"tid3r.state.scene.edits.length < {before}", "an edit undone")

    def run(self, minutes):
        self.tour.load()
        self.undo_all()
        self.browser.js("window.first = JSON.stringify(tid3r.state.scene.instances);")
        least = None
        end = time.monotonic() + 60 * minutes
        while time.monotonic() < end:
            for _ in range(SPELL):
                action = self.random.choice(self.ACTIONS)
                action(self)
                self.settle(action.__name__)
                self.done[action.__name__] = self.done.get(action.__name__, 0) + 1
                if self.count("edits") >= MOST_EDITS:
                    self.undo_all()
            self.agree()
            page, server = self.memory()
            print(f"{sum(self.done.values()):6} actions, page {page:6.1f} MB, server {server:6.1f} MB", flush=True)
            # What is remembered of the first minutes is there to stay.
            least = least or (page, server)
        self.undo_all()
        self.agree()
        if not self.browser.js("return window.first === JSON.stringify(tid3r.state.scene.instances);"):
            raise Failed("all edits undone, the room is another")
        if page > 2 * least[0] + 20 or server > 1.5 * least[1] + 50:
            raise Failed(f"memory went from {least} to {(page, server)} MB")
        print(", ".join(f"{count} x {name}" for name, count in sorted(self.done.items())))
