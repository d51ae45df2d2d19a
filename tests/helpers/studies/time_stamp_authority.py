"""Time stamping authorities for tests, based on the program openssl."""

import subprocess
from pathlib import Path

_CONFIGURATION = """\
[req]
distinguished_name = name
[name]
[root]
basicConstraints = critical, CA:true
keyUsage = critical, keyCertSign
[authority]
basicConstraints = critical, CA:false
keyUsage = critical, digitalSignature
extendedKeyUsage = critical, timeStamping
[tsa]
default_tsa = own
[own]
serial = serial
default_policy = 1.2.3.4.1
digests = sha256, sha512
signer_digest = sha256
ess_cert_id_alg = sha256
"""


class Authority:
    """A time stamping authority with its own root certificate."""

    def __init__(self, folder: Path, name: str = "Test Authority") -> None:
        folder.mkdir(parents=True)
        self._folder = folder
        (folder / "openssl.cnf").write_text(_CONFIGURATION)
        (folder / "serial").write_text("01")
        self._openssl(
            *("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", "root.key", "-out", "root.pem"),
            *("-days", "3650", "-subj", f"/CN={name} Root", "-config", "openssl.cnf", "-extensions", "root"),
        )
        self._openssl(
            *("req", "-newkey", "rsa:2048", "-nodes", "-keyout", "tsa.key", "-out", "tsa.csr"),
            *("-subj", f"/CN={name}", "-config", "openssl.cnf"),
        )
        self._openssl(
            *("x509", "-req", "-in", "tsa.csr", "-CA", "root.pem", "-CAkey", "root.key", "-CAcreateserial"),
            *("-out", "tsa.pem", "-days", "3650", "-extfile", "openssl.cnf", "-extensions", "authority"),
        )

    @property
    def root(self) -> bytes:
        """Return the root certificate as PEM."""
        return (self._folder / "root.pem").read_bytes()

    def stamp(self, data: bytes, digest: str = "sha256", with_root: bool = True) -> bytes:
        """Return a time stamp of data with its certificates."""
        (self._folder / "data").write_bytes(data)
        self._openssl("ts", "-query", "-data", "data", f"-{digest}", "-cert", "-out", "query.tsq")
        chain = ("-chain", "root.pem") if with_root else ()
        self._openssl(
            *("ts", "-reply", "-queryfile", "query.tsq", "-signer", "tsa.pem", "-inkey", "tsa.key"),
            *("-config", "openssl.cnf", "-section", "own", *chain, "-out", "reply.tsr"),
        )
        return (self._folder / "reply.tsr").read_bytes()

    def _openssl(self, *arguments: str) -> None:
        subprocess.run(("openssl", *arguments), cwd=self._folder, check=True, capture_output=True)
