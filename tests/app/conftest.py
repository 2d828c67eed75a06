"""A server over a folder of its own, called without a network, whose workers are real processes."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator

import pandas as pd
import pytest
from fastapi.testclient import TestClient

from dieseltwin.app.server import create_app
from dieseltwin.app.workplace import Limits, Workplace
from tests.api.simulated import drive

ORIGIN = "http://127.0.0.1"
FOREIGN = {
    "time_s": "Zeit [s]", "n_e_rpm": "Motordrehzahl [1/min]", "u_delta_mg": "Einspritzmenge [mg/Hub]",
    "u_egr_pct": "AGR <b>Ventil</b> [%]", "u_vgt_pct": "VTG_Pos [%]", "p_im_pa": "Ladedruck abs [kPa]",
    "p_em_pa": "Abgasgegendruck abs [kPa]", "omega_t_rad_s": "n_ATL [rad/s]", "w_egr_kg_s": "AGR Massenstrom [kg/s]",
    "t_em_k": "T_Abgas [degC]", "w_c_kg_s": "Luftmasse [kg/s]",
}  # fmt: skip


def logged(table: pd.DataFrame, decimal: str = ",") -> bytes:
    """What a German logger would have written: other names, other units, semicolons, a name full of HTML."""
    foreign = table.assign(p_im_pa=table.p_im_pa / 1e3, p_em_pa=table.p_em_pa / 1e3, t_em_k=table.t_em_k - 273.15)
    return foreign.rename(columns=FOREIGN).to_csv(index=False, sep=";", decimal=decimal).encode()


@pytest.fixture(scope="session")
def logger_csv() -> bytes:
    """65 s of it."""
    return logged(drive(65.0), ".")


@pytest.fixture(scope="session")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Workplace:
    return Workplace(tmp_path_factory.mktemp("page") / "kept", Limits(upload_mb=5))


@pytest.fixture(scope="session")
def client(workplace: Workplace) -> Iterator[TestClient]:
    with TestClient(create_app(workplace), base_url=ORIGIN, headers={"Origin": ORIGIN}) as found:
        yield found


Waiting = Callable[[str, str], str]


@pytest.fixture(scope="session")
def wait_for(client: TestClient) -> Waiting:
    """Ask for a page until it holds a pattern; fails after two minutes with the page's words."""

    def until(path: str, pattern: str) -> str:
        end = time.monotonic() + 60.0
        while True:
            text = client.get(path).text
            if re.search(pattern, text):
                return text
            if 'role="alert"' in text or time.monotonic() > end:
                raise AssertionError(f"{path} never held {pattern}: {re.sub(r'<[^>]+>', ' ', text)[-1500:]}")
            time.sleep(0.2)

    return until


@pytest.fixture(scope="session")
def recording(client: TestClient, logger_csv: bytes, wait_for: Waiting) -> str:
    """Path of the page of a recording that was dropped, once its channels are known."""
    files = {"file": ("../../Fahrt <i>7</i>.csv", logger_csv)}
    answer = client.post("/recordings", files=files, follow_redirects=False)
    assert answer.status_code == 303
    path = answer.headers["location"]
    wait_for(path, "map-title")
    return path
