# SPDX-License-Identifier: MIT
import json
import re
from base64 import b64decode
from pathlib import Path

import pytest
from jinja2 import DictLoader, UndefinedError

from salsanext_cli.report.page import rendering

HOSTILE = "</script><b>&\"'\x07"


@pytest.fixture
def page(monkeypatch):
    """Return a function that renders the text of a template."""

    def render(template: str, **values: object) -> str:
        monkeypatch.setattr(
            rendering, "PackageLoader", lambda _: DictLoader({"page.html": template})
        )
        return rendering.render(values)

    return render


def test_markup_and_control_characters_in_texts_are_escaped(page):
    assert page("{{ text }}", text=HOSTILE) == "&lt;/script&gt;&lt;b&gt;&amp;&#34;&#39;\\x07"


def test_no_text_in_the_data_can_end_its_element(page):
    text = page("{{ data | tojson }}", data={"z": [HOSTILE], "a": 1})
    assert not {"<", ">", "&"}.intersection(text)
    # Keys keep their order.
    assert list(json.loads(text).items()) == [("z", [HOSTILE]), ("a", 1)]


def test_numbers_that_are_not_finite_are_refused(page):
    with pytest.raises(ValueError, match="JSON"):
        page("{{ data | tojson }}", data=float("nan"))


def test_a_name_without_a_value_is_an_error(page):
    with pytest.raises(UndefinedError):
        page("{{ absent }}")


def test_a_style_is_included_as_it_is(page):
    style = page("{{ style() }}")
    assert ">" in style
    assert "&gt;" not in style


def test_every_script_is_in_the_page_and_imports_scripts_of_it():
    addresses = rendering.import_map()["imports"]
    files = Path(rendering.__file__).parent.joinpath("scripts").glob("*.js")
    assert addresses.keys() == {f"page/{file.name}" for file in files}
    for address in addresses.values():
        source = b64decode(address.removeprefix("data:text/javascript;base64,")).decode()
        imported = re.findall(r'\bfrom "([^"]*)"', source)
        assert len(imported) == len(re.findall(r"^import ", source, re.MULTILINE))
        assert addresses.keys() >= {*imported}
