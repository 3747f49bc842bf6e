"""Who a process is on the bus: its TLS certificate, its key, and the authority it trusts.

    DIR/host/{authority,certificate,key}.pem       the env host's
    DIR/agent_0/{authority,certificate,key}.pem    one agent's: all that its host needs
    DIR/observer/...                               of launchers that look at a run from elsewhere

`python -m otc_dist.certs DIR` makes them. The certificate's common name is the process's name, and
access control (see `access`) goes by it.
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Self

from otc_dist.terminal.errors import UserError

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

AUTHORITY, CERTIFICATE, KEY = "authority.pem", "certificate.pem", "key.pem"
_MAKE = "python -m otc_dist.certs makes certificates"


@dataclass(frozen=True)
class Identity:
    """Paths of a process's PEM files."""

    authority: Path
    certificate: Path
    key: Path

    @classmethod
    def load(cls, folder: Path, process: str) -> Self:
        """The identity of `process` among those in `folder`, checked as far as it can be alone.

        Raises:
            UserError: a file is missing or no such file; the certificate is another's, of another
                authority or key, or not valid today.
        """
        paths = [(folder / process / name).absolute() for name in (AUTHORITY, CERTIFICATE, KEY)]
        for path in paths:
            if not path.is_file():
                raise UserError(
                    f"no certificate of {process} in {folder}: {path} is missing; {_MAKE}"
                )
        identity = cls(*paths)
        identity._check(process)
        return identity

    def _check(self, process: str) -> None:
        # Imported here: it takes a tenth of a second, and runs on one machine need none of it.
        from cryptography import x509
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.serialization import load_pem_private_key

        path = self.certificate
        try:
            path = self.authority
            authority = x509.load_pem_x509_certificate(path.read_bytes())
            path = self.certificate
            certificate = x509.load_pem_x509_certificate(path.read_bytes())
            path = self.key
            key = load_pem_private_key(path.read_bytes(), None)
        except OSError as error:
            raise UserError(f"cannot read {path}: {error.strerror}") from None
        except (ValueError, TypeError):
            raise UserError(
                f"{path} is damaged or not a PEM file without password; {_MAKE}"
            ) from None
        if common_name(certificate) != process:
            raise UserError(
                f"{self.certificate} is {common_name(certificate)}'s certificate, not {process}'s"
            )
        if key.public_key() != certificate.public_key():
            raise UserError(f"{self.key} is not the key of {self.certificate}; {_MAKE}")
        try:
            certificate.verify_directly_issued_by(authority)
        except (ValueError, TypeError, InvalidSignature):
            raise UserError(
                f"{self.certificate} was not issued by {self.authority}; {_MAKE}"
            ) from None
        now = datetime.now(UTC)
        for what, checked in ((self.authority, authority), (self.certificate, certificate)):
            if now > checked.not_valid_after_utc:
                raise UserError(
                    f"{what} expired on {checked.not_valid_after_utc:%Y-%m-%d}; {_MAKE}"
                )
            if now < checked.not_valid_before_utc:
                raise UserError(
                    f"{what} is valid from {checked.not_valid_before_utc:%Y-%m-%d} on:"
                    " is this machine's clock right?"
                )

    def settings(self) -> dict[str, object]:
        """Zenoh's settings for mutual TLS, on whichever side of a link."""
        certificate, key = str(self.certificate), str(self.key)
        values: dict[str, object] = {
            "root_ca_certificate": str(self.authority),
            "listen_certificate": certificate,
            "listen_private_key": key,
            "connect_certificate": certificate,
            "connect_private_key": key,
            "enable_mtls": True,
            # Zenoh trusts the web's authorities beside ours, so the name decides as well.
            "verify_name_on_connect": True,
            # Zenoh 1.10 panics when it closes a link that it would close by itself one day.
            "close_link_on_expiration": False,
        }
        return {f"transport/link/tls/{name}": value for name, value in values.items()}


def common_name(certificate: "Certificate") -> str:
    """The name of the process that a certificate is of; empty if it has none."""
    from cryptography.x509.oid import NameOID

    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""
