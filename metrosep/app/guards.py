"""Who may talk to the workbench: pages of this very server, with the token of this start.

A web site that the user visits could send requests to the loopback (cross-site), or have its own
name point there (DNS rebinding). Both come with a Host or Origin that is not ours.
"""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["COOKIE", "Guard"]

COOKIE = "metrosep"
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


@dataclass(frozen=True, slots=True)
class Guard:
    """The rule for one server."""

    token: str  # of this start
    port: int  # where the server listens

    @property
    def cookie(self) -> str:
        """Name of the cookie: cookies are shared by all ports of a host."""
        return f"{COOKIE}-{self.port}"

    def refusal(
        self, headers: Mapping[str, str], *, token: str | None, cookies: Mapping[str, str]
    ) -> str | None:
        """Return why a request is refused, or None.

        Examples
        --------
        >>> guard = Guard("secret", 8899)
        >>> guard.refusal({"host": "127.0.0.1:8899"}, token="secret", cookies={})
        >>> guard.refusal({"host": "evil.example:8899"}, token="secret", cookies={})
        'the host is not the loopback of this computer'
        """
        host = headers.get("host", "")
        if host not in {f"{name}:{self.port}" for name in _LOOPBACK}:
            return "the host is not the loopback of this computer"
        origin = headers.get("origin")
        if origin is not None and origin not in {f"http://{n}:{self.port}" for n in _LOOPBACK}:
            return "the request comes from another site"
        given = token if token is not None else cookies.get(self.cookie, "")
        if not hmac.compare_digest(given.encode(), self.token.encode()):
            return (
                "the token is missing or of another start; open the address that metrosep printed"
            )
        return None
