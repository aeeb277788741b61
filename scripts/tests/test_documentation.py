"""The documentation against the project: links lead somewhere, and metrics and reasons of errors are those that exist."""

import re
import unittest
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parent.parent.parent
PAGES = [*CHECKOUT.glob("*.md"), *(CHECKOUT / "docs").glob("*.md")]


class Documentation(unittest.TestCase):
    def test_links_lead_to_files_and_headings_that_exist(self):
        broken = []
        for page in PAGES:
            for bracketed, plain in re.findall(r"\]\((?:<([^>\n]+)>|([^)\s<]+))\)", page.read_text(encoding="utf-8")):
                target = bracketed or plain
                if re.match(r"[a-z]+:", target):
                    continue
                name, _, heading = target.partition("#")
                file = (page.parent / name).resolve() if name else page
                if not file.exists() or (heading and heading not in anchors(file)):
                    broken.append(f"{page.relative_to(CHECKOUT)}: {target}")
        self.assertEqual(broken, [])

    def test_every_reason_of_an_error_is_documented_with_its_code(self):
        documented = re.findall(r"^\| `([A-Z_]+)` \| `([A-Z_]+)` \|", (CHECKOUT / "docs" / "protocol.md").read_text(encoding="utf-8"), re.MULTILINE)
        source = (CHECKOUT / "proto" / "src" / "status.rs").read_text(encoding="utf-8")
        exist = re.findall(r'^    [A-Za-z]+ = "([A-Z_]+)", ([A-Za-z]+);$', source, re.MULTILINE)
        exist = [(name, re.sub(r"(?<=.)([A-Z])", r"_\1", code).upper()) for name, code in exist]
        self.assertGreater(len(exist), 15)
        self.assertEqual(sorted(documented), sorted(exist))

    def test_the_metrics_page_is_complete_and_true(self):
        documented = set(re.findall(r"^\| `(cross_\w+)`", (CHECKOUT / "docs" / "observability.md").read_text(), re.MULTILINE))
        exported = set()
        for crate in ("actor", "learner", "support"):
            for source in (CHECKOUT / crate / "src").rglob("*.rs"):
                exported.update(re.findall(r'"(cross_(?:actor|learner|expert|cluster|build|thread)_[a-z_]+)"', source.read_text()))
        self.assertEqual(documented - exported, set(), "documented, but nowhere in actor, learner or support")
        self.assertEqual(exported - documented, set(), "exported, but not documented")


def anchors(page):
    """The headings of a page as links name them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


if __name__ == "__main__":
    unittest.main()
