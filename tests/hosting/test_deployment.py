"""The Compose file and the image of the host name options, variables and extras that the program has."""

import os
import re
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from typer.testing import CliRunner

from avrgym.cli import app
from avrgym.study.storage.database import DATABASE_URL_VARIABLE, find_database_url
from avrgym.study.storage.object_store import OBJECT_STORE_VARIABLE, open_object_store
from avrgym.vr.server.network_addresses import DEFAULT_PORT
from avrgym.vr.server.real_time_loop import REAL_TIME_PRIORITY
from helpers.studies.small_studies import small_study
from helpers.system.paths import ROOT

TEXT = (ROOT / "deploy" / "compose.yaml").read_text()
GIVEN = {
    "STUDY_DOMAIN": "study.example",
    "STUDY_FOLDER": "/data/my-study",
    "POSTGRES_PASSWORD": "secret",
    "S3_SECRET_KEY": "other",
}
VARIABLE = re.compile(r"\$\{(\w+)(?::\?[^}]*)?\}")


@pytest.fixture
def services() -> dict[str, Any]:
    """The services of the Compose file, with the variables of a user."""
    return yaml.safe_load(VARIABLE.sub(lambda match: GIVEN[match[1]], TEXT))["services"]


@pytest.fixture
def variables(services: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """The environment variables of the host."""
    for name in [each for each in os.environ if each.startswith("AWS_")]:
        monkeypatch.delenv(name)
    for name, value in services["host"]["environment"].items():
        monkeypatch.setenv(name, value)
    return services["host"]["environment"]


def test_the_first_lines_name_every_variable_of_the_user() -> None:
    exported = re.findall(r"(\w+)=", TEXT.partition("export ")[2].partition("\n")[0])
    assert sorted(exported) == sorted({match[1] for match in VARIABLE.finditer(TEXT)}) == sorted(GIVEN)


def test_the_command_parses_the_options_of_the_host(services: dict[str, Any]) -> None:
    assert 'ENTRYPOINT ["avrgym"]' in image(services)
    name, *options = services["host"]["command"]
    command: Any = typer.main.get_command(app).commands[name]  # pyright: ignore[reportAttributeAccessIssue]
    parsed = command.make_context(name, options).params
    assert parsed["study"] == Path("/study")
    assert (parsed["address"], parsed["proxy"]) == ("https://study.example", ["127.0.0.1"])
    proxied = ["--from", GIVEN["STUDY_DOMAIN"], "--to", f"127.0.0.1:{parsed['port']}"]
    assert services["proxy"]["command"].split()[2:] == proxied
    assert parsed["port"] == DEFAULT_PORT
    mounted = [each.rpartition(":")[2] for each in services["host"]["volumes"]]
    assert str(parsed["study"]) in mounted
    (home,) = re.findall(r"VOLUME .*(/home/\w+)", image(services))
    assert home in mounted  # contains the key of names
    assert services["host"]["ulimits"]["rtprio"] >= REAL_TIME_PRIORITY


@pytest.mark.skipif(find_spec("boto3") is None, reason="the object store is an extra")
def test_the_host_uses_the_addresses_and_passwords_of_the_services(
    services: dict[str, Any], variables: dict[str, str]
) -> None:
    assert {each for each in variables if not each.startswith("AWS_")} == {
        DATABASE_URL_VARIABLE,
        OBJECT_STORE_VARIABLE,
    }
    database, recordings = services["database"], services["recordings"]
    assert find_database_url("").endswith(
        f":{database['environment']['POSTGRES_PASSWORD']}@{published(database)}/"
        f"{database['environment']['POSTGRES_DB']}"
    )
    store = open_object_store("")
    assert store is not None
    client = store._client
    assert client.meta.endpoint_url == f"http://{published(recordings)}"
    credentials = client._request_signer._credentials
    assert [credentials.access_key, credentials.secret_key] == list(recordings["environment"].values())


def test_the_image_has_the_extras_of_the_services(services: dict[str, Any]) -> None:
    (extras,) = re.findall(r'\.whl\)\[(.+)\]"', image(services))
    known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    installed = [each for extra in extras.split(",") for each in known[extra]]
    assert {"sqlalchemy", "psycopg", "boto3"} <= {re.split(r"[\[>=]", each)[0] for each in installed}


def test_a_cluster_without_its_extra_names_the_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "avrgym.system.cluster", raising=False)
    result = CliRunner().invoke(app, ["host", str(small_study(tmp_path / "study")), "--cluster", "local"])
    assert result.exit_code == 1
    assert "ray is missing; run `pip install 'avrgym[cluster]'`" in result.output


def image(services: dict[str, Any]) -> str:
    """The container file of the host's image."""
    build = services["host"]["build"]
    return (ROOT / "deploy" / build["context"] / build["dockerfile"]).read_text()


def published(service: dict[str, Any]) -> str:
    """Address and port of a service on the loopback interface of the server."""
    (port,) = service["ports"]
    address, outside, _ = port.split(":")
    assert address == "127.0.0.1"
    return f"{address}:{outside}"
