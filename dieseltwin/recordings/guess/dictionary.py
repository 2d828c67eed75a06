"""Words of other languages and abbreviations, put into the English words that the vocabulary of names knows.

`data/channel_dictionary.yaml` holds the words. What isn't among them may be several of them in one
("laddluftstemperatur"), one without its vowels ("mnfld"), the beginning of one ("manif") or one behind the letter of
what is measured ("tscav").
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources

import yaml

LEAST_PART, LEAST_SKELETON, LEAST_BEGINNING = 3, 3, 4  # letters of a part of a compound, of consonants, of a beginning
LINKS = ("", "s", "n", "e", "en", "a", "o")  # between the parts of a compound
_LETTERS = dict(zip("абвгдезийклмнопрстуфцыэ", "abvgdeziiklmnoprstufcye", strict=True)) | {
    "ё": "e", "ж": "zh", "х": "kh", "ч": "ch", "ш": "sh", "щ": "shch",
    "ъ": "", "ь": "", "ю": "yu", "я": "ya"}  # fmt: skip
_CYRILLIC = _LETTERS | {letter.upper(): latin.capitalize() for letter, latin in _LETTERS.items()}
LEAST_SPELT = 5  # consonants of a word that kept some of its vowels
SYMBOLS = {"p": "pressure", "t": "temperature", "n": "speed"}
MEASURED_LAST = frozenset(("mass", "quantity", "flow", "pressure", "temperature", "speed", "torque", "position"))
VOWELS = frozenset("aeiouy")


@dataclass(frozen=True)
class Dictionary:
    """All words that are known.

    Attributes:
        exact: word -> English word.
        stems: beginning of a word -> English word, where any ending may follow.
        characters: Chinese or Japanese term -> English word.
    """

    exact: dict[str, str]
    stems: dict[str, str]
    characters: dict[str, str]

    def in_letters(self, name: str) -> str:
        """A name in Latin letters: Cyrillic letter by letter, Chinese and Japanese terms as English words."""
        if name.isascii():
            return name
        for term in sorted(self.characters, key=len, reverse=True):
            name = name.replace(term, f" {self.characters[term]} ")
        return "".join(_CYRILLIC.get(letter, letter) for letter in name)

    def english(self, word: str) -> str | None:
        """The English of one word of a name, several words for a compound; None where nothing is known."""
        for spelling in dict.fromkeys((word, _without_umlauts(word))):
            if spelling in self.exact:
                return self.exact[spelling]
            if len(spelling) < LEAST_SKELETON or not spelling.isalpha():
                return None
            found = self._compound(spelling) or self._inflected(spelling) or self._behind_symbol(spelling)
            found = found or self._abbreviated(spelling)
            if found is not None:
                return found
        return None

    def _compound(self, word: str) -> str | None:
        """Fewest parts and letters between them that make up the whole word, best[k] for its first k letters."""
        best: list[tuple[int, tuple[str, ...]] | None] = [(0, ())] + [None] * len(word)
        for end in range(LEAST_PART, len(word) + 1):
            for start in range(end - LEAST_PART + 1):
                before = best[start]
                part = word[start:end]
                english = self.exact.get(part) or self.stems.get(part)
                if before is None or english is None:
                    continue
                for link in LINKS:
                    reach = end + len(link)
                    if reach > len(word) or word[end:reach] != link:
                        continue
                    made = (before[0] + 2 + len(link), (*before[1], english))
                    held = best[reach]
                    if held is None or made[0] < held[0]:
                        best[reach] = made
        return " ".join(best[-1][1]) if best[-1] else None

    def _inflected(self, word: str) -> str | None:
        fitting = [stem for stem in self.stems if word.startswith(stem)]
        return self.stems[max(fitting, key=len)] if fitting else None

    def _behind_symbol(self, word: str) -> str | None:
        """'tscav': the symbol of a quantity and the place where it is measured in one word."""
        place = self.exact.get(word[1:]) if len(word) > LEAST_BEGINNING and word[0] in SYMBOLS else None
        return None if place is None else f"{place} {SYMBOLS[word[0]]}"

    def _abbreviated(self, word: str) -> str | None:
        """The only meaning whose words begin so, or have these consonants."""
        known = {**self.stems, **self.exact}
        if len(word) >= LEAST_BEGINNING:
            begun = {english for full, english in known.items() if full.startswith(word)}
            if len(begun) == 1:
                return begun.pop()
        if VOWELS & set(word[1:]):
            consonants = _skeleton(word)
            same = {english for full, english in known.items() if _skeleton(full) == consonants}
            return same.pop() if len(same) == 1 and len(consonants) >= LEAST_SPELT else None
        bare = {english for full, english in known.items() if _skeleton(full).startswith(word)}
        return bare.pop() if len(bare) == 1 else None


def _without_umlauts(word: str) -> str:
    """'foere' -> 'fore': other languages than German write the letters without the e."""
    return word.replace("ae", "a").replace("oe", "o").replace("ue", "u")


@cache
def _skeleton(word: str) -> str:
    """A word without its vowels, but for one that it begins with."""
    return word[:1] + "".join(letter for letter in word[1:] if letter not in VOWELS)


@cache
def dictionary() -> Dictionary:
    """The dictionary as it stands in the package."""
    text = resources.files("dieseltwin").joinpath("data/channel_dictionary.yaml").read_text(encoding="utf-8")
    exact: dict[str, str] = {}
    stems: dict[str, str] = {}
    content = yaml.safe_load(text)
    for english, words in content["words"].items():
        for word in words:
            (stems if word.endswith("*") else exact).setdefault(word.rstrip("*"), english)
    terms = {term: english for english, written in content["characters"].items() for term in written}
    return Dictionary(exact, stems, terms)


@cache
def translated(words: str) -> str:
    """The words of a name in English, what is measured last; those of which nothing is known stay as they are."""
    english = " ".join(dictionary().english(word) or word for word in words.split()).split()
    return " ".join(sorted(english, key=MEASURED_LAST.__contains__))
