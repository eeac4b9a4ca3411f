"""Paths and URLs as a user types them: their secrets are removed from messages, and failures are explained."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import unquote, urlsplit

from quadlog.errors import FileError, QuadlogError, StorageFailed

_PROTOCOL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
# Outside HTTP a `?` may stand in a name; what says NAME=VALUE behind one does not. The value may hold any character.
_QUERY = re.compile(r"\?[^/?]*=")
# A password may hold a `/` that nobody escaped; HOST:PORT/PLACE@NAME has none.
_USER = re.compile(r"(?<=://)(?:[^/]*|[^/:]*:(?!\d+/)[^@]*)@")
_IN_TEXT = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://[^\s'\"<>]+")


def is_url(text: object) -> bool:
    """Whether a text names a place by URL; a path never has `://` in it once it is a Path."""
    return "://" in str(text)


def is_web(url: str) -> bool:
    """Whether a web server gives it, which lists nothing and takes nothing."""
    return url.partition("://")[0].lower() in ("http", "https")


def local_path(url: str) -> Path:
    """The path that a file:// URL names. Raises FileError."""
    try:
        parts = urlsplit(url)
    except ValueError as error:  # brackets without an address, or a host name that Unicode would change
        raise FileError(redacted(url), f"no URL that quadlog can read: {error}") from error
    if parts.netloc not in ("", "localhost"):
        raise FileError(redacted(url), "a file:// URL of another machine; mount it, or name its path")
    path = unquote(parts.path)
    if "\0" in path:
        raise FileError(redacted(url), "no path has a NUL in it")
    return Path(path)


def protocol_of(url: str) -> str:
    """The protocol, in small letters. Raises FileError where there is none."""
    match = _PROTOCOL.match(url)
    if match is None or len(url) == match.end():
        raise FileError(redacted(url), "no URL that quadlog can read; write PROTOCOL://PLACE")
    return match[1].lower()


def split_query(url: str) -> tuple[str, str]:
    """The URL without what stands behind its path, and that."""
    if is_web(url):
        cut = min((place for place in (url.find("?"), url.find("#")) if place >= 0), default=len(url))
    else:
        found = _QUERY.search(url)
        cut = found.start() if found else len(url)
    return url[:cut], url[cut:]


def redacted(url: str) -> str:
    """The URL as it may be shown and saved: without user and password, and without its query, which may sign it."""
    place, query = split_query(_USER.sub("", url))
    return place + ("?..." if query else "")


def secrets_in(url: str) -> list[str]:
    """The words of a URL that `redacted` leaves out."""
    user = _USER.search(url)
    hidden = (user[0].rstrip("@") if user else "") + " " + split_query(url)[1]
    return [word for word in re.split(r"[\s/:?&=@#]+", hidden) if word]


def redacted_text(text: str) -> str:
    """A text with all URLs in it redacted."""
    return _IN_TEXT.sub(lambda match: redacted(match[0]), text)


_MOST_WORDS = 200
_REFUSED = "access is refused; check the credentials, or the URL's signature"
# By name: the packages that define them may not be installed, and need not be loaded to look.
_NAMES = {
    "no credentials; set AWS_PROFILE, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY "
    "(of a public bucket: FSSPEC_S3_ANON=true)": "NoCredentialsError PartialCredentialsError",
    "no such host": "ClientConnectorDNSError",
    "the server's certificate is not trusted": "ClientConnectorCertificateError",
    "the server cannot be reached": "ClientConnectorError EndpointConnectionError ConnectionRefusedError",
    "the connection to the server breaks off": "ClientOSError ServerDisconnectedError ConnectionResetError "
    "ConnectionAbortedError BrokenPipeError ConnectionClosedError",
    "the server ends its answers too early": "ClientPayloadError IncompleteReadError ResponseStreamingError",
    "not a valid URL": "InvalidURL InvalidUrlClientError",
    "the server redirects without end": "TooManyRedirects",
}
_REASONS = {name: reason for reason, names in _NAMES.items() for name in names.split()}


@contextmanager
def explained(url: str) -> Iterator[None]:
    """What a library raises within becomes StorageFailed; FileNotFoundError and quadlog's own errors pass."""
    try:
        yield
    except QuadlogError:
        raise
    except FileNotFoundError:
        raise FileNotFoundError(redacted(url)) from None
    except Exception as error:
        raise StorageFailed(redacted(url), reason_of(error, url)) from error


def reason_of(error: BaseException, url: str) -> str:
    """One phrase for the user: nothing of its secrets in it, no more than a line."""
    status = getattr(error, "status", None)
    names = [cls.__name__ for cls in type(error).__mro__]
    if isinstance(error, PermissionError) or status in (401, 403):
        return _REFUSED
    for name in names:
        if name in _REASONS:
            return _REASONS[name]
    if isinstance(error, TimeoutError) or any("Timeout" in name for name in names):
        return "the server did not answer in time"
    if isinstance(status, int) and status:
        return f"the server answers with status {status}"
    # The number of an operating system's error says nothing that its words do not.
    cause = (error.strerror if isinstance(error, OSError) else None) or error
    words = " ".join(redacted_text(str(cause)).split())
    if any(re.search(rf"(?<!\w){re.escape(secret)}(?!\w)", words) for secret in secrets_in(url)):
        words = ""
    return words[:_MOST_WORDS] or f"the request fails ({type(error).__name__})"
