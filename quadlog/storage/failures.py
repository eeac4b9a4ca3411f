"""What libraries raise when a server fails, as one line of quadlog's."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from quadlog.errors import QuadlogError, StorageFailed
from quadlog.storage.urls import redacted, redacted_text, secrets_in

_MOST_WORDS = 200
_BROKEN_OFF = "the connection to the server breaks off"
_TOO_EARLY = "the server ends its answers too early"
_REFUSED = "access is refused; check the credentials, or the URL's signature"
_NO_CREDENTIALS = (
    "no credentials; set AWS_PROFILE, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY "
    "(of a public bucket: FSSPEC_S3_ANON=true)"
)
# By name: the packages that define them may not be installed, and need not be loaded to look.
_REASONS = {
    "NoCredentialsError": _NO_CREDENTIALS,
    "PartialCredentialsError": _NO_CREDENTIALS,
    "ClientConnectorDNSError": "no such host",
    "ClientConnectorCertificateError": "the server's certificate is not trusted",
    "ClientConnectorError": "the server cannot be reached",
    "EndpointConnectionError": "the server cannot be reached",
    "ConnectionRefusedError": "the server cannot be reached",
    "ClientOSError": _BROKEN_OFF,
    "ServerDisconnectedError": _BROKEN_OFF,
    "ConnectionResetError": _BROKEN_OFF,
    "ConnectionAbortedError": _BROKEN_OFF,
    "BrokenPipeError": _BROKEN_OFF,
    "ConnectionClosedError": _BROKEN_OFF,
    "ClientPayloadError": _TOO_EARLY,
    "IncompleteReadError": _TOO_EARLY,
    "ResponseStreamingError": _TOO_EARLY,
    "InvalidURL": "no URL that can be asked for",
    "InvalidUrlClientError": "no URL that can be asked for",
    "TooManyRedirects": "the server redirects without end",
}


@contextmanager
def explained(url: str) -> Iterator[None]:
    """What a library raises within becomes StorageFailed; FileNotFoundError and quadlog's own errors pass."""
    try:
        yield
    except (QuadlogError, FileNotFoundError):
        raise
    except Exception as error:
        raise StorageFailed(redacted(url), reason_of(error, url)) from error


def reason_of(error: BaseException, url: str) -> str:
    """One phrase for whoever typed the URL: nothing of its secrets in it, no more than a line."""
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
    told = (error.strerror if isinstance(error, OSError) else None) or error
    words = " ".join(redacted_text(str(told)).split())
    if any(re.search(rf"(?<!\w){re.escape(secret)}(?!\w)", words) for secret in secrets_in(url)):
        words = ""
    return words[:_MOST_WORDS] or f"the request fails ({type(error).__name__})"
