"""Addresses of cameras with what must not be seen taken out: passwords and tokens."""

from __future__ import annotations

import re

# http://user:password@host (RFC 3986, 3.2.1). The password ends at the last @ before the path begins.
_USER = re.compile(r"(?<=://)[^/\s\"'?#]*@")
# IP cameras also take them as parameters, by such names.
_PARAMETER = re.compile(r"(?i)([?&](?:user\w*|usr|login|pass\w*|pwd|psw|token|auth|key|secret)=)[^&\s\"'#]*")


def without_secrets(text: str) -> str:
    """The text with user names, passwords and tokens of all addresses in it taken out."""
    return _PARAMETER.sub(r"\1...", _USER.sub("", text))
