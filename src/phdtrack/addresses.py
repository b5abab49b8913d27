"""Addresses of cameras, webhooks and brokers: their secrets are hidden in all texts, and may come
from the environment or from files.

Cameras expect passwords in many places: before the host, in the query, in the path. Therefore only
the parts of an address that are known to be harmless are shown: host and port, short words of the
path, and numbers behind parameters such as ``channel``. "…" replaces everything else.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit, urlunsplit

# Schemes by which an address is recognised even if a path library has removed a slash.
_KNOWN = "rtsps?|rtmps?|rtp|rtsp[tu]|https?|mqtts?|srt|udp|tcp|ftps?|wss?|mms|hls"
_SCHEME = re.compile(rf"(?i)[a-z][a-z0-9+.-]{{0,29}}://|(?<![a-z])(?:{_KNOWN}):/(?!/)")
_OPENING = {"'": "'", '"': '"', "<": ">", "`": "`"}
# What ends a sentence or a clause is no part of the address before it.
_TRAILING = ".,:;!?)]}'\""
_PLACE = re.compile(r"(?:, (?:frame|line|row) \d{1,12})+$")
_HOST = re.compile(r"(?:[A-Za-z0-9_.-]{1,255}|\[[0-9A-Fa-f:.]{2,50}\])(?::\d{1,5})?")
# A host that cannot be a user: a user name with a number as password looks like host and port.
_CERTAIN_HOST = re.compile(
    r"(?:\d{1,3}(?:\.\d{1,3}){3}|\[[0-9A-Fa-f:.]{2,50}\])(?::\d{1,5})?"
    r"|[A-Za-z0-9-]{1,63}(?:\.[A-Za-z0-9-]{1,63})+"
)
_KEY = re.compile(r"(?:^|(?<=[?&;,_/]))([A-Za-z][A-Za-z0-9.-]{0,30})=")
_PLACEHOLDER = re.compile(r"\{(env|file):([^{}]+)\}")
# In a text without an address: a user and a password before a host, and parameters.
_USER = re.compile(r"(?<![^\s'\"(=])[^\s/:@'\"(=]{1,100}:[^\s@]{1,200}@(?=[A-Za-z0-9\[])")
_SECRET = re.compile(
    r"(?i)([a-z0-9_.-]{0,30}(?:passw|pwd|token|secret|loginpas|credential|api_?key|auth(?!or))"
    r"[a-z0-9_.-]{0,30}=)[^&#\s'\"]{1,200}"
)
_PARAMETER = re.compile(
    r"(?i)([?&][^=&?\s]{0,60}(?:pas|pwd|token|secret|key|auth)[^=&?\s]{0,60}=)[^&#\s]*"
)
# Words of a path behind which the next part is a name or a password.
_LOGIN = re.compile(r"(?i)user|admin|pas|pwd|login|auth|token|key|secret")
# Words that may have a number behind them, and the only ones in a query without "=".
_CAMERA_WORDS = (
    "av axis c cam cams camera cameras cgi ch chn channel channels codec d enablesrtp fps g h "
    "hd high i image img input jpeg jpg live low m main media mjpeg mjpg motion mp mpeg n onvif "
    "p play profile profiles real s screen sd sdp stream streaming streams sub t tcp track "
    "trackid tracks tv udp unicast multicast v video videos view x "
)
_WORDS = frozenset(_CAMERA_WORDS.split())
# Parameters whose values, numbers or such words, are shown.
_HARMLESS_NAMES = (
    "audio bitrate c cam camera cameraid ch channel channelid channels chn codec compression "
    "fps framerate h height mode n no number profile proto q quality rate res resolution s size "
    "stream streamid streamtype subtype trackid transportmode unicast v video videocodec w "
    "width x y "
)
_HARMLESS = frozenset(_HARMLESS_NAMES.split())
_SUFFIXES = "avi|cgi|fcgi|amp|asf|asp|flv|gif|h26[45]|jpe?g|m2?ts|m3u8|m4v|mjpe?g|mjpg|mkv|mov|mp4"
_SUFFIX = re.compile(rf"(?i)\.(?:{_SUFFIXES}|mpe?g|ogv|php|png|sdp|smil|ts|webm|webp|wmv|3gp)$")
_WORD = re.compile(
    r"[a-z]{1,12}|[A-Z]{1,12}|(?:[a-z]{3,12}|[A-Z][a-z]{2,12})(?:[A-Z][a-z]{2,12}){0,2}"
)
_NUMBERED = re.compile(r"([A-Za-z]{0,12})\d{1,4}")
_NAME = re.compile(r"[a-z]{1,12}|[a-z]{0,12}(?:[A-Z][a-z]{2,12}){1,2}|[A-Z]{1,4}")
_ENDS_HOST = re.compile(r"[/?#\s]")
_VALUE = re.compile(r"\d{1,5}(?:x\d{1,5})?")


def shown(text: str) -> str:
    """The text, an address or a sentence, without the parts of the addresses in it that may be user
    names, passwords and tokens.
    """
    if not any(mark in text for mark in (":/", "@", "=")):
        return text
    found = _beginnings(text)
    if not found:
        return _plain_text(text)
    if not found[0].start():
        # The text begins with an address: blanks are a part of it up to a place in it.
        place = _PLACE.search(text)
        end = place.start() if place else len(text)
        if len(found) == 1 and not re.search(r"[:,.] ", text[:end]):
            return _address(found[0][0], text[found[0].end() : end]) + text[end:]
    pieces = [_plain_text(text[: found[0].start()])]
    for k, match in enumerate(found):
        limit = len(text)
        if k + 1 < len(found):
            limit = found[k + 1].start()
        end = _end(text, match, limit)
        pieces.append(_address(match[0], text[match.end() : end]))
        pieces.append(_plain_text(text[end:limit]))
    return "".join(pieces)


def named(address: str) -> str:
    """A short name of a source for folders and pages, of letters, digits, points and hyphens."""
    plain = shown(address)
    try:
        parts = urlsplit(plain)
    except ValueError:
        return "camera"
    if parts.netloc:
        plain = urlunsplit(("", parts.netloc.rpartition("@")[2], parts.path, "", ""))
    return re.sub(r"[^A-Za-z0-9.-]+", "-", plain).strip("-.") or "camera"


def filled(address: str) -> str:
    """The address with the values of ``{env:NAME}`` and ``{file:PATH}`` in it, the variables of the
    environment and the contents of the files, so that other users do not see them in the list of
    processes. Special characters of the values are escaped. The result must not be stored.

    A text that is one of these and nothing else is replaced by the value as it is: the whole
    address. Raises ``LookupError`` with a sentence if there is no such variable or file.
    """
    whole = _PLACEHOLDER.fullmatch(address)
    if whole:
        return _value(whole[1], whole[2])
    return _PLACEHOLDER.sub(lambda match: quote(_value(match[1], match[2]), safe=""), address)


def resolved(source: str) -> str:
    """The camera's address, number or file that a source stands for, as `filled` for addresses; the
    names of files stay as they are.
    """
    if "://" in source or _PLACEHOLDER.fullmatch(source):
        return filled(source)
    return source


def _value(kind: str, name: str) -> str:
    """The content of a variable of the environment or of a file, without the end of its line."""
    if kind == "env":
        if name not in os.environ:
            raise LookupError(f"the environment has no variable {name}")
        return os.environ[name]
    try:
        return Path(name).read_text("utf-8").rstrip("\r\n")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is no text in UTF-8"
        raise LookupError(f"the file {name} cannot be read ({reason})") from None


def _beginnings(text: str) -> list[re.Match[str]]:
    """The schemes of the addresses in a text; one that follows without a blank is a part of the
    address before.
    """
    found = list[re.Match[str]]()
    before = -1
    for match in _SCHEME.finditer(text):
        if before < 0 or any(map(str.isspace, text[before : match.start()])):
            found.append(match)
        before = match.end()
    return found


def _end(text: str, match: re.Match[str], limit: int) -> int:
    """The end of an address in a text: the quote that closes it or a blank, except that a password
    before an @ in the same line may have blanks.
    """
    begin = match.end()
    line = text.find("\n", begin, limit)
    if line >= 0:
        limit = line
    before = text[match.start() - 1 : match.start()]
    closing = text.rfind(_OPENING[before], begin, limit) if before in _OPENING else -1
    if closing >= 0:
        return closing
    at = text.rfind("@", begin, limit)
    blank = re.compile(r"\s|$").search(text, max(begin, at + 1), limit)
    end = blank.start() if blank else limit
    while end > max(begin, at + 1) and text[end - 1] in _TRAILING:
        end -= 1
    return end


def _address(scheme: str, rest: str) -> str:
    """An address without its secrets; ``rest`` follows the scheme and its slashes."""
    if scheme.lower() == "file://":
        return scheme + rest
    user, rest = _without_user(rest)
    authority = _ENDS_HOST.split(rest, maxsplit=1)[0]
    if not _HOST.fullmatch(authority):
        return f"{scheme}{user}…"
    path, fragment, _ = rest[len(authority) :].partition("#")
    path, question, query = path.partition("?")
    path = _path(path)
    if question:
        query = "?" + _query(query)
    return f"{scheme}{user}{authority}{path}{query}{'#…' if fragment else ''}"


def _without_user(rest: str) -> tuple[str, str]:
    """The user as "…@", empty without one, and what follows; nothing follows if it is not certain
    where a password ends.
    """
    authority = _ENDS_HOST.split(rest, maxsplit=1)[0]
    user, at, host = rest.rpartition("@")
    if not at or _CERTAIN_HOST.fullmatch(authority):
        return "", rest
    # An @ behind the first / may stand in a password, and in a path.
    in_host = len(user) < len(authority)
    if in_host or not ("@" in user or _HOST.fullmatch(authority)):
        return "…@", host
    return "", ""


def _path(path: str) -> str:
    """A path with its harmless words, and … for others."""
    key = _KEY.search(path)
    pairs = ""
    if key:
        pairs = path[key.start() - 1] + _pairs(path[key.start() :])
        path = path[: key.start() - 1]
    parts = path.split("/")
    for k, part in enumerate(parts):
        after_login = k > 0 and _LOGIN.search(parts[k - 1])
        if part and (after_login or not _harmless(part)):
            parts[k] = "…"
    return "/".join(parts) + pairs


def _query(query: str) -> str:
    """A query with its names, and those values that are harmless."""
    first = _KEY.search(query)
    before = query[: first.start()] if first else query
    words = re.split(r"([&;,_/?])", before)
    shown_words = [word if k % 2 or _known(word) else "…" for k, word in enumerate(words) if word]
    return "".join(shown_words) + (_pairs(query[first.start() :]) if first else "")


def _pairs(text: str) -> str:
    """Pairs of name=value: a value extends to the next name."""
    pieces = _KEY.split(text)
    out = [pieces[0]]
    for k in range(1, len(pieces), 2):
        name = pieces[k]
        value = pieces[k + 1]
        separator = ""
        if k + 2 < len(pieces):
            separator = value[-1:]
            value = value[:-1]
        plain, *more = re.split(r"(?=[&;?])", value, maxsplit=1)
        number = _SUFFIX.sub("", plain)
        known = name.lower() in _HARMLESS and (_VALUE.fullmatch(number) or _known(number))
        if not (known or not plain or _PLACEHOLDER.fullmatch(plain)):
            plain = "…"
        elif more:
            plain += "".join(more[0][:1] + _query(more[0][1:]))
        # A token may end in "=", and look like a name.
        pair = f"{name}={plain}" if _NAME.fullmatch(name) else "…"
        out.append(pair + separator)
    return "".join(out)


def _harmless(part: str) -> bool:
    """True for a part of a path made of short words and small numbers, or the name of a file."""
    part = unquote(part)
    if len(part) > 60:
        return False
    stem, files = _SUFFIX.subn("", part)
    words = [word for word in re.split(r"[-_.+, ]", stem) if word]
    if files and all(_NUMBERED.fullmatch(word) or _WORD.fullmatch(word) for word in words):
        return True
    return all(map(_known_or_short, words))


def _known_or_short(word: str) -> bool:
    return bool(_WORD.fullmatch(word)) or _known(word)


def _known(word: str) -> bool:
    """True for a word that occurs in addresses of many cameras, and for a small number."""
    numbered = _NUMBERED.fullmatch(word)
    stem = numbered[1] if numbered else word
    return stem.lower() in _WORDS or not stem


def _plain_text(text: str) -> str:
    """A text between addresses, without user:password@ and values of secret parameters."""
    text = _USER.sub("…@", text)
    text = _SECRET.sub(r"\1…", text)
    return _PARAMETER.sub(r"\1…", text)
