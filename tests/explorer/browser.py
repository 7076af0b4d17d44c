"""The page in a browser, driven as a person drives it."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from base64 import b64encode
from hashlib import sha256
from pathlib import Path
from typing import Any

from sphtrunc.explorer.assembly import page

#: those of this machine; where there is none, tests that need one say that they were not run
BROWSERS = [name for name in ("chromium", "google-chrome") if shutil.which(name)]
DRIVER = Path(__file__).with_name("driver.js").read_text(encoding="utf-8")
CATCHER = (
    "const ERRORS = [];"
    "addEventListener('error', (e) => ERRORS.push(e.message));"
    "addEventListener('unhandledrejection', (e) => ERRORS.push(String(e.reason)));"
    "addEventListener('securitypolicyviolation', (e) => ERRORS.push(e.violatedDirective));"
)
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)


def hashed(text: str) -> str:
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"


#: a frame of a width that a window of its own cannot have, which writes down what it is told
FRAME = (
    "<iframe src='driven.html' width='{}' height='900'></iframe><pre></pre><script>"
    "onmessage = (e) => {{ document.querySelector('pre').textContent = e.data; }};</script>"
)


def driven(
    browser: str, folder: Path, settings: list[dict[str, str]], width: int = 1400
) -> dict[str, Any]:
    """What the page shows for the settings, in a browser of that width."""
    code = f"const SETTINGS = {json.dumps(settings)};\n{DRIVER}"
    text = page().replace("script-src ", f"script-src {hashed(CATCHER)} {hashed(code)} ")
    text = text.replace("<style>", f"<script>{CATCHER}</script><style>", 1)
    text = text.replace("</body>", f"<script>{code}</script></body>")
    (folder / "driven.html").write_text(text, encoding="utf-8")
    file = folder / "frame.html"
    file.write_text(FRAME.format(width), encoding="utf-8")
    run = subprocess.run(
        [browser, *FLAGS, f"--user-data-dir={folder / 'profile'}", "--window-size=1600,900",
         f"--virtual-time-budget={1_000_000}", "--dump-dom", file.as_uri()],
        capture_output=True, text=True, check=True, timeout=600,
    )  # fmt: skip
    found = re.search(r"<pre>(.+?)</pre>", run.stdout, flags=re.DOTALL)
    assert found, run.stdout[:2000]
    return dict(json.loads(html.unescape(found[1])))
