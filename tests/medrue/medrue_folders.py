"""What the folders hold that programs of `medrue` write."""

import json
from html.parser import HTMLParser

from calib.core.base.own_files import MANIFEST


class Checker(HTMLParser):
    """Counts tables and images, and remembers links."""

    def __init__(self):
        super().__init__()
        self.counts: dict[str, int] = {}
        self.links: list[str] = []

    def handle_starttag(self, tag, attributes):
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.links += [value for name, value in attributes if name == "href" and value]


def check_tables(tables):
    for table in tables:
        assert "nan" not in table.csv()
        assert "simulated" in table.csv()
        assert len(set(table.columns[0].values)) == len(table.columns[0].values)  # rows are selected by name
        json.dumps(table.to_dict(), allow_nan=False)


def check_folder(folder, tables, figures, data=()):
    expected = {f"{name}.{kind}" for name in tables for kind in ("csv", "json")}
    expected |= {f"{name}.{kind}" for name in figures for kind in ("png", "svg")} | {"index.html", *data}
    assert {path.name for path in folder.iterdir()} - {MANIFEST} == expected
    for name in figures:
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "<text" in (folder / f"{name}.svg").read_text()  # not outlines
    for name in tables:
        content = json.loads((folder / f"{name}.json").read_text())
        assert content["simulated"] is True
        assert content["rows"]
    text = (folder / "index.html").read_text()
    page = Checker()
    page.feed(text)
    assert page.counts["table"] == len(tables)
    assert page.counts["img"] == len(figures)
    assert set(page.links) == expected - {"index.html"}
    assert "Simulated" in text
    plain = text.replace("http://www.w3.org", "").replace("http-equiv", "")
    assert "http" not in plain  # asks nobody for anything
