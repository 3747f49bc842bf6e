"""An authority of one's own, and a certificate for each process.

    DIR/authority/{certificate,key}.pem            never leaves this machine
    DIR/host/{authority,certificate,key}.pem       and so on: see `otc_dist.bus.identity`

A learner's certificate is good for a client only, so that nobody can pose as the env host with it.
"""

import ipaddress
import os
import socket
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from otc_dist.bus.addresses import HOST_FORM, is_host
from otc_dist.bus.identity import AUTHORITY, CERTIFICATE, KEY, Identity
from otc_dist.bus.keys import HOST, OBSERVER
from otc_dist.run.folder import holding
from otc_dist.system import durable
from otc_dist.terminal.errors import UserError

_AUTHORITY_FOLDER = "authority"
_EARLIER = timedelta(days=1)  # valid since: other hosts' clocks may be slow
_AUTHORITY_YEARS = 10
_RENEW = timedelta(days=14)  # before the end


def make(folder: Path, agents: Sequence[str], names: Sequence[str], days: float) -> Iterator[str]:
    """Make what is missing or about to expire in `folder`; yields a line for each process.

    Args:
        names: host names and addresses by which the learners reach the env host.
        days: for which the certificates are valid.

    Raises:
        UserError: a name is none; the folder cannot be written, or holds something else: another
            authority's certificates, or a run.
    """
    for name in names:
        if not is_host(name):
            raise UserError(f"--host {name!r} is not {HOST_FORM}: write it as learners connect to")
    if held_by := holding(folder):
        raise UserError(
            f"{held_by} is the folder of a run or a comparison, which others may get to see: make"
            " certificates elsewhere"
        )
    try:
        _make_private(folder)
        _check_own(folder, (HOST, *agents, OBSERVER))
        authority = _Authority.of(folder / _AUTHORITY_FOLDER)
        for process in (HOST, *agents, OBSERVER):
            reached_by = tuple(names) if process == HOST else ()
            where = folder / process
            if _is_good(folder, process, reached_by):
                yield f"{where}: kept"
            else:
                authority.issue(where, process, reached_by, days)
                known = f", for {', '.join(reached_by)}" if reached_by else ""
                yield f"{where}: made, valid for {days:g} days{known}"
    except OSError as error:
        raise UserError(f"cannot write {error.filename or folder}: {error.strerror}") from None


def _make_private(folder: Path) -> None:
    """Make `folder` so that nobody else may enter it, whatever the umask.

    Raises:
        UserError: others can write in it, so that what it holds may be theirs.
        OSError: it cannot be made.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.stat()
    if status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise UserError(
            f"others can write in {folder}, so its certificates cannot be trusted: delete it, or"
            " use another folder"
        )


def _check_own(folder: Path, processes: Sequence[str]) -> None:
    """Raises UserError: a certificate is another authority's, and would be lost."""
    own = folder / _AUTHORITY_FOLDER / CERTIFICATE
    known = own.read_bytes() if own.exists() else b""
    for process in processes:
        theirs = folder / process / AUTHORITY
        if theirs.exists() and theirs.read_bytes() != known:
            raise UserError(
                f"{theirs.parent} was made by an authority that is not in {folder}: keep it, and"
                " make certificates where that authority is, or in another folder"
            )


def own_names() -> tuple[str, ...]:
    """Names and addresses by which this machine is likely to be reached."""
    names = [socket.gethostname(), socket.getfqdn(), "localhost", "127.0.0.1"]
    try:
        found = socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
        names += [str(address[0]) for *_, address in found]
    except OSError:
        pass  # its own name cannot be resolved
    return tuple(dict.fromkeys(filter(is_host, names)))


class _Authority:
    """Issues certificates."""

    def __init__(self, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
        self._certificate, self._key = certificate, key

    @classmethod
    def of(cls, folder: Path) -> "_Authority":
        """The authority in `folder`; made if there is none."""
        if not folder.exists():
            return cls._new(folder)
        try:
            certificate = x509.load_pem_x509_certificate((folder / CERTIFICATE).read_bytes())
            key = serialization.load_pem_private_key((folder / KEY).read_bytes(), None)
        except (ValueError, TypeError, FileNotFoundError):
            raise UserError(f"{folder} is damaged: delete {folder.parent} to begin anew") from None
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise UserError(f"{folder / KEY} was not made by otc_dist: use another folder")
        if datetime.now(UTC) + _RENEW > certificate.not_valid_after_utc:
            raise UserError(
                f"the authority in {folder} expires: delete {folder.parent} to begin anew"
            )
        return cls(certificate, key)

    @classmethod
    def _new(cls, folder: Path) -> "_Authority":
        key = ec.generate_private_key(ec.SECP256R1())
        name = _name("otc_dist authority")
        usage = _key_usage(signs_certificates=True)
        certificate = (
            _builder(name, name, key, timedelta(days=365 * _AUTHORITY_YEARS))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(usage, critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False)
            .sign(key, hashes.SHA256())
        )
        _write(folder, {CERTIFICATE: _pem(certificate), KEY: _pem_key(key)})
        return cls(certificate, key)

    def issue(self, folder: Path, process: str, reached_by: Sequence[str], days: float) -> None:
        """Write a new key and certificate of `process`, reached by these names, into `folder`."""
        key = ec.generate_private_key(ec.SECP256R1())
        purposes = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if reached_by:
            purposes.append(ExtendedKeyUsageOID.SERVER_AUTH)
        builder = (
            _builder(_name(process), self._certificate.subject, key, timedelta(days=days))
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_key_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), False
            )
        )
        if reached_by:
            names = x509.SubjectAlternativeName(list(map(_general_name, reached_by)))
            builder = builder.add_extension(names, critical=False)
        certificate = builder.sign(self._key, hashes.SHA256())
        contents = {
            AUTHORITY: _pem(self._certificate),
            CERTIFICATE: _pem(certificate),
            KEY: _pem_key(key),
        }
        _write(folder, contents)


def _is_good(folder: Path, process: str, reached_by: Sequence[str]) -> bool:
    """Whether `process` has a certificate that need not be made again."""
    try:
        identity = Identity.load(folder, process)
        authority = (folder / _AUTHORITY_FOLDER / CERTIFICATE).read_bytes()
    except (UserError, OSError):
        return False
    certificate = x509.load_pem_x509_certificate(identity.certificate.read_bytes())
    known = set()
    for extension in certificate.extensions:
        if isinstance(extension.value, x509.SubjectAlternativeName):
            known = set(extension.value)
    lasts = datetime.now(UTC) + _RENEW < certificate.not_valid_after_utc
    same = identity.authority.read_bytes() == authority
    return lasts and same and known >= set(map(_general_name, reached_by))


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, lasts: timedelta
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLIER)
        .not_valid_after(now + lasts)
    )


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _general_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _pem_key(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _write(folder: Path, contents: dict[str, bytes]) -> None:
    """Files that only their owner can read."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    for name, content in contents.items():
        durable.write(folder / name, content, mode=0o600)
