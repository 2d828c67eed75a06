"""What is none of this server's own pages' business is refused, and no name of a browser's names a file here."""

from __future__ import annotations

import pytest
from fastapi.testclient import TestClient

from dieseltwin.app.workplace import Workplace, is_id, new_id, shown_name


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80", "", "[::1"])
def test_names_that_are_not_ours_are_refused(client: TestClient, host: str) -> None:
    assert client.get("/", headers={"Host": host}).status_code == 421


@pytest.mark.parametrize("host", ["localhost:8765", "127.0.0.1", "[::1]:8765", "192.168.0.7:8765"])
def test_numbers_and_localhost_are_ours(client: TestClient, host: str) -> None:
    assert client.get("/", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [{"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": "http://127.0.0.1:9"},
     {"Origin": "", "Sec-Fetch-Site": "cross-site"}],
)  # fmt: skip
def test_changes_come_from_our_own_pages_alone(client: TestClient, headers: dict[str, str]) -> None:
    answer = client.post("/recordings", files={"file": ("a.csv", b"a;b\n1;2\n")}, headers=headers)
    assert answer.status_code == 403


def test_a_request_without_any_origin_changes_nothing(client: TestClient) -> None:
    request = client.build_request("POST", "/recordings", files={"file": ("a.csv", b"a;b\n1;2\n")})
    del request.headers["Origin"]
    assert client.send(request).status_code == 403


def test_pages_carry_a_policy_without_inline_scripts(client: TestClient) -> None:
    for path in ("/", "/engines", "/compare", "/nothing", "/static/app.js"):
        answer = client.get(path)
        policy = answer.headers["content-security-policy"]
        assert "script-src 'self';" in policy and "unsafe" not in policy and "frame-ancestors 'none'" in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "<script>" not in answer.text and "style=" not in answer.text and "http://" not in answer.text


@pytest.mark.parametrize(
    "path",
    ["/recordings/..%2f..%2fetc", "/recordings/....//", "/jobs/%2e%2e/report.html", "/static/..%2fserver.py",
     "/static/%2e%2e/%2e%2e/api/reading.py", "/engines/..%5c..", "/engines/0123456789abcdeg/engine.yaml"],
)  # fmt: skip
def test_no_path_leads_out(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 404 and "import" not in answer.text


def test_too_large_is_refused_announced_or_not(client: TestClient) -> None:
    content = bytes(7_000_000)
    assert client.post("/recordings", files={"file": ("a.csv", content)}).status_code == 413

    def parts():  # no length is announced
        yield b'--x\r\nContent-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\n'
        for _ in range(70):
            yield bytes(100_000)
        yield b"\r\n--x--\r\n"

    answer = client.post("/recordings", content=parts(), headers={"Content-Type": "multipart/form-data; boundary=x"})
    assert answer.status_code == 413 and "5 MB" in answer.text


@pytest.mark.parametrize(
    ("sent", "shown"),
    [("../../etc/passwd", "passwd"), ("C:\\Users\\me\\drive.mf4", "drive.mf4"), ("", "without a name"),
     ("a\x00b\n.csv", "ab.csv"), ("..", ".."), ("x" * 300, "x" * 100), ("\u202egpj.exe", "gpj.exe")],
)  # fmt: skip
def test_names_are_shown_clean(sent: str, shown: str) -> None:
    assert shown_name(sent) == shown


@pytest.mark.parametrize(
    "name", ["../../../../tmp/out.csv", "/etc/cron.d/x.csv", "a.csv\x00.sh", "<script>alert(1)</script>.csv"]
)
def test_hostile_names_reach_no_disk_and_no_page(client: TestClient, workplace: Workplace, name: str) -> None:
    answer = client.post("/recordings", files={"file": (name, b"a;b\n1;2\n")}, follow_redirects=False)
    path = answer.headers["location"]
    folder = workplace.recordings / path.rsplit("/", 1)[-1]
    assert {file.name for file in folder.iterdir()} <= {
        "about.json", "recording.csv", "recording.bin", "map.yaml", "channels.json", "overview.png",
    }  # fmt: skip
    assert "<script>alert" not in client.get(path).text
    client.post(f"{path}/remove")


def test_ids_are_hexadecimal_and_long() -> None:
    assert is_id(new_id()) and new_id() != new_id()
    assert not any(map(is_id, ("", "..", "0" * 15, "0" * 17, "0123456789ABCDEF", "0123456789abcde/", "0" * 16 + "\n")))
