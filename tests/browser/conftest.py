"""Pages in a real browser: one start for each kind of page, with a probe from this folder inside."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.quadlog.results.conftest import browse, tiny_original, tiny_record, tiny_run, write_run  # noqa: F401

HERE = Path(__file__).parent
Probe = Callable[..., dict[str, Any]]


@pytest.fixture
def probe(browse: Callable[..., tuple[str, list[str]]], tmp_path: Path) -> Probe:  # noqa: F811
    """Opens a page with NAME.js inside, in a frame of exactly this size; gives what it says.

    Nothing may complain on the console.
    """

    def ask(page: Path, name: str, size: tuple[int, int] = (1440, 900), fragment: str = "", library: str = "") -> Any:
        text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text())
        before, after = ((HERE / f"{each}.js").read_text() for each in ("before", name))
        text = text.replace("</head>", f"<script>{before}</script><script>{library}</script></head>", 1)
        (tmp_path / "probed.html").write_text(text.replace("</body>", f"<script>{after}</script></body>"))
        frame = f'<iframe src="probed.html{fragment}" width="{size[0]}" height="{size[1]}" style="border:0"></iframe>'
        outer = tmp_path / "outer.html"
        outer.write_text(f"<body>{frame}<script>onmessage = ({{ data }}) => (document.title = data);</script></body>")
        dom, complaints = browse(outer, "--dump-dom", "--window-size=1600,1200", "--virtual-time-budget=5000")
        assert complaints == []
        (title,) = re.findall(r"<title>(.*?)</title>", dom, re.DOTALL)
        said = json.loads(html.unescape(title))
        assert "failed" not in said, said
        return said

    return ask
