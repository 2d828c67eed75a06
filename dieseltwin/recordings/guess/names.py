"""What names say, by the vocabulary in `data/channel_names.yaml`: English, German, abbreviations, numbers of J1939."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

import yaml

from dieseltwin.recordings.guess.dictionary import dictionary, translated

_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "Ä": "AE", "Ö": "OE", "Ü": "UE", "ø": "o",
                          "å": "a", "æ": "ae", "ł": "l", "ı": "i", "Å": "A", "Ø": "O"})  # fmt: skip
_FIRST_UMLAUT = re.compile(r"[ÄÖÜ](?=[a-zäöüß])")  # of a word with a capital, not of a word of capitals
_SPN = re.compile(r"\bspn[ :#-]*(\d{2,6})\b", re.IGNORECASE)
_BRACKETS = re.compile(r"[\[(][^\[\]()]*[\])]")
_RECIRCULATED = re.compile(r"\bexh\w*( ga?s)? re?ci?rcu?la?ti?o?n\b")  # vowels left out or not
_PART = re.compile(r"<([A-Z_]+)>")
TRANSLATED = 0.95  # of the score, where the dictionary put the name into English
LATER_SPN = 0.03  # of the score for each number that stands before it
COMMANDS = ("u_delta_mg", "u_egr_pct", "u_vgt_pct")  # what a control unit wants of these it nearly gets
WANTED_ONLY = 0.65  # of the score, where only what was wanted is recorded


@dataclass(frozen=True)
class Meaning:
    """One thing that a channel can be.

    Attributes:
        name: in words ("fuel volume flow").
        column: our column that it gives.
        dimensions: of units that fit.
        says: (pattern over the words, score 0 to 1).
        rules_out: pattern over the words.
        spns: numbers of J1939 that are this, best first.
        commanded: words of a wanted value.
        plain: words beside a meaning's own that say nothing more.
        usual: range of a median in our unit, which decides on the file's unit; None for the rules of `reading`.
        least: absolute pressure [Pa] below which no reading can be: what is lower is gauge.
    """

    name: str
    column: str
    dimensions: tuple[str, ...]
    says: tuple[tuple[re.Pattern[str], float], ...]
    rules_out: re.Pattern[str]
    spns: tuple[int, ...]
    commanded: re.Pattern[str]
    plain: re.Pattern[str]
    usual: tuple[float, float] | None = None
    least: float = 0.0

    def score(self, name: str, words: str, spn: int | None) -> float:
        """How clearly a channel's number or name says this, 0 to 1."""
        if spn is not None:
            return 1.0 - LATER_SPN * self.spns.index(spn) if spn in self.spns else 0.0
        if name.lower() == self.column:
            return 1.0
        if self.wanted(words):
            return WANTED_ONLY * self.score(name, self.commanded.sub("asked", words), None)
        if self.ruled_out(words):
            return 0.0
        english = translated(words)
        abroad = 0.0 if self.rules_out.search(english) else TRANSLATED * self._said(english)
        return max(self._said(words), abroad)

    def ruled_out(self, words: str) -> bool:
        """Whether the name is of something else, by its own words or by those of another language beside them."""
        if self.rules_out.search(words):
            return True
        beside = " ".join(self._unread(words))
        return beside != "" and self.rules_out.search(translated(beside)) is not None

    def _said(self, words: str) -> float:
        return max((score for pattern, score in self.says if pattern.search(words)), default=0.0)

    def _unread(self, words: str) -> list[str]:
        spans = [match.span() for pattern, _ in self.says for match in pattern.finditer(words)]
        return [word.group() for word in re.finditer(r"\S+", words) if not self.plain.fullmatch(word.group())
                and not any(start < word.end() and word.start() < end for start, end in spans)]  # fmt: skip

    def wanted(self, words: str) -> bool:
        """Whether the name is of a wanted value that may stand for what was given."""
        return self.column in COMMANDS and self.commanded.search(words) is not None

    def unread(self, words: str) -> list[str]:
        """Words that no pattern of this meaning takes in and that aren't plain: it may be another thing."""
        if self._said(translated(words)) > self._said(words):
            words = translated(words)
        return self._unread(words)


@dataclass(frozen=True)
class Vocabulary:
    """All meanings, and the dimensions that words allow where a file gives no unit."""

    meanings: tuple[Meaning, ...]
    kinds: Mapping[str, re.Pattern[str]]

    def kinds_of(self, words: str) -> frozenset[str]:
        """Dimensions that a name allows."""
        both = (words, translated(words))
        return frozenset(kind for kind, pattern in self.kinds.items() if any(pattern.search(each) for each in both))


@cache
def vocabulary(section: str = "meanings") -> Vocabulary:
    """The vocabulary as it stands in the package, for the quantities of one kind of machine."""
    text = resources.files("dieseltwin").joinpath("data/channel_names.yaml").read_text(encoding="utf-8")
    content = yaml.safe_load(text)

    def pattern(expression: str) -> re.Pattern[str]:
        return re.compile(_PART.sub(lambda part: content["parts"][part.group(1)], expression))

    meanings = tuple(
        Meaning(
            name,
            entry["column"],
            tuple(entry["units"]),
            tuple((pattern(each), float(score)) for score, patterns in entry["says"].items() for each in patterns),
            pattern(entry["rules_out"]),
            tuple(entry.get("spns", ())),
            re.compile(content["commanded"]),
            pattern(content["plain"]),
            (float(entry["usual"][0]), float(entry["usual"][1])) if "usual" in entry else None,
            float(entry.get("least", 0.0)),
        )
        for name, entry in content[section].items()
    )
    kinds = {kind: pattern(expression) for kind, expression in content["kinds"].items()}
    return Vocabulary(meanings, kinds)


def words_of(name: str) -> str:
    """A name as lower-case words between blanks: 'InjCtl_qSetUnBal' -> 'inj ctl q set un bal'."""
    name = _FIRST_UMLAUT.sub(lambda found: found.group().translate(_UMLAUTS).capitalize(), name)
    bare = unicodedata.normalize("NFKD", dictionary().in_letters(name).translate(_UMLAUTS))
    text = _BRACKETS.sub(" ", "".join(letter for letter in bare if not unicodedata.combining(letter)))
    text = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", text)
    text = re.sub(r"([A-Z]+)([A-Z][a-z])", r"\1 \2", text)
    text = re.sub(r"([A-Za-z]{3,})(\d)", r"\1 \2", text)  # turbo1, but p2 and T31 stay
    text = re.sub(r"[^A-Za-z0-9]+", " ", text).strip().lower()
    return _RECIRCULATED.sub("egr", re.sub(r"\s+", " ", text))


def spn_of(name: str, given: int | None) -> int | None:
    """The J1939 number of a channel: the file's own, or one that the name spells ('SPN 102', 'EEC1_SPN190')."""
    if given is not None:
        return given
    found = _SPN.search(name.replace("_", " "))
    return int(found.group(1)) if found else None
