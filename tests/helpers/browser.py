"""A headless Chromium, asked through its debugging protocol."""

import json
import shutil
import subprocess
import time
import urllib.request
from contextlib import contextmanager

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
OPTIONS = (
    "--headless=new --no-sandbox --disable-dev-shm-usage --use-gl=angle --use-angle=swiftshader "
    "--enable-unsafe-swiftshader --hide-scrollbars --disable-background-networking "
    "--remote-debugging-port=0 --remote-allow-origins=*"
)


class Page:
    """An open page: JavaScript in it, its messages and what it requested."""

    def __init__(self, socket):
        self.socket, self.count, self.messages, self.requests = socket, 0, [], []

    def call(self, method, **options):
        self.count += 1
        self.socket.send(json.dumps({"id": self.count, "method": method, "params": options}))
        while True:
            answer = json.loads(self.socket.recv(timeout=60))
            if answer.get("id") == self.count:
                assert "error" not in answer, answer
                return answer["result"]
            if answer["method"] in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown"):
                self.messages.append(answer["params"])
            elif answer["method"] == "Network.requestWillBeSent":
                self.requests.append(answer["params"]["request"]["url"])

    def ask(self, code):
        """Return what the body of an asynchronous function returns."""
        wrapped = f"(async () => {{ {code} }})()"
        found = self.call(
            "Runtime.evaluate", expression=wrapped, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")


@contextmanager
def opened(path, folder, size=(1200, 800)):
    """Give the `Page` of a file as soon as its player runs."""
    from websockets.sync.client import connect

    profile = folder / "profile"
    command = [CHROMIUM, *OPTIONS.split(), f"--user-data-dir={profile}",
               "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
               f"--window-size={size[0]},{size[1]}", "about:blank"]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        place = profile / "DevToolsActivePort"
        for _ in range(300):
            if place.exists() and place.read_text().strip():
                break
            time.sleep(0.1)
        port = place.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            target = next(t for t in json.load(answer) if t["type"] == "page")
        with connect(target["webSocketDebuggerUrl"], max_size=None) as socket:
            page = Page(socket)
            for domain in ("Runtime", "Network", "Page"):
                page.call(f"{domain}.enable")
            page.call("Page.navigate", url=path.as_uri())
            ready = "return typeof player !== 'undefined' && player instanceof Player"
            for _ in range(300):
                if page.ask("return document.readyState") == "complete" and page.ask(ready):
                    break
                time.sleep(0.1)
            yield page
    finally:
        process.kill()
        process.wait()
