"""What may stand for a machine, in an endpoint, in a certificate or after `ssh`."""

import ipaddress
import re

HOST_FORM = "a host name or an IP address"
_LABEL = r"[A-Za-z0-9_](?:[A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?"
# A last label of digits alone is that of a mistyped address.
_NAME = re.compile(rf"(?:{_LABEL}\.)*(?![0-9]+\Z){_LABEL}")
_LONGEST_NAME = 253


def is_host(text: str) -> bool:
    """Whether `text` is a DNS name or an IP address: then it is also safe in a command line."""
    return _is_address(text) or (len(text) <= _LONGEST_NAME and _NAME.fullmatch(text) is not None)


def is_ipv6(host: str) -> bool:
    """Whether a host is an IPv6 address, which is written in brackets before a port."""
    return ":" in host


def in_brackets(host: str) -> str:
    """A host as it is written before a colon: `[2001:db8::1]`, `192.0.2.1`."""
    return f"[{host}]" if is_ipv6(host) else host


def _is_address(text: str) -> bool:
    if "%" in text:  # the zone after it is anything, and means something only on one machine
        return False
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True
