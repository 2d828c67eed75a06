"""From a dropped file to a verdict, without a browser: forms, workers, what is kept, and what is refused."""

from __future__ import annotations

import re

import yaml
from fastapi.testclient import TestClient

from dieseltwin.api.histories import history
from dieseltwin.app.desk import Desk
from dieseltwin.app.kept import JobState, Outcome, now, save
from dieseltwin.app.workplace import Workplace
from dieseltwin.atomic import write_json
from dieseltwin.learning.history import History
from dieseltwin.sealed import sealed_json
from tests.app.conftest import Waiting
from tests.learning.test_history import entry
from tests.report import synthetic_discovery


def chosen(page: str, column: str) -> str:
    """Words of the channel that a form has chosen for a quantity."""
    box = re.search(rf'<select name="channel-{column}">(.*?)</select>', page, re.DOTALL)
    assert box is not None
    found = re.search(r"<option[^>]* selected>(.*?)</option>", box.group(1))
    assert found is not None
    return found.group(1)


def form_of(page: str) -> dict[str, str]:
    """The fields of the channel map's form as a browser would send them."""
    form = page[page.index('/map">') : page.index("</form>", page.index('/map">'))]
    fields = dict(re.findall(r'<input [^>]*name="([^"]+)" value="([^"]*)"', form))
    for name, box in re.findall(r'<select name="([^"]+)">(.*?)</select>', form, re.DOTALL):
        value = re.search(r'<option value="([^"]*)" selected>', box)
        fields[name] = "" if value is None else value.group(1)
    return fields


def test_a_dropped_file_is_mapped_by_guess_and_its_names_stay_text(client: TestClient, recording: str) -> None:
    page = client.get(recording).text
    assert "<h1>Fahrt &lt;i&gt;7&lt;" not in page  # the part before the slash of the hostile name is gone
    assert "i&gt;7&lt;/i" not in page and "<b>Ventil" not in page and "AGR &lt;b&gt;Ventil&lt;/b&gt;" in page
    assert chosen(page, "p_im_pa").startswith("Ladedruck abs [kPa]")
    assert chosen(page, "t_im_k") == "none"
    assert client.get(f"{recording}/overview.png").content.startswith(b"\x89PNG")
    comments = client.get(f"{recording}/map.yaml").text.split("\n")[:2]
    assert "recording." not in comments[0] and "identify recording." not in comments[1]  # the server's name for it


def test_a_map_is_mended_and_tried(client: TestClient, recording: str, wait_for: Waiting) -> None:
    fields = form_of(client.get(recording).text)
    assert fields["reading-p_im_pa"] == "unit:kPa" and fields["reading-time_s"] == "unit:s"
    twice = client.post(f"{recording}/map", data={**fields, "channel-p_em_pa": fields["channel-p_im_pa"]})
    assert twice.status_code == 422 and "chosen for p_im_pa and p_em_pa" in twice.text
    wrong = client.post(f"{recording}/map", data={**fields, "scale-p_im_pa": "one"})
    assert wrong.status_code == 422 and "a number" in wrong.text
    assert client.post(f"{recording}/map", data={**fields, "reading-p_im_pa": "unit:bar"}).status_code == 200
    assert "p_im_pa" in wait_for(recording, r'class="alert"><p>')  # 14,000 kPa of boost: the reader says so
    assert client.post(f"{recording}/map", data=fields).status_code == 200
    assert "1.1 minutes at 5 Hz" in wait_for(recording, "can be read")
    kept = yaml.safe_load(client.get(f"{recording}/map.yaml").text)
    assert kept["Ladedruck abs [kPa]"] == {"column": "p_im_pa", "unit": "kPa"}


def desk_of(client: TestClient) -> Desk:
    """The server's own."""
    found = client.app.state.desk
    assert isinstance(found, Desk)
    return found


def finished(client: TestClient, key: str, **changes: float) -> str:
    """A discovery that ended: a job of the server's store with a real document in it; returns its id."""
    store = desk_of(client).store
    job = store.new_job("discover", "What is left out of Fahrt 7", (key,))
    document = synthetic_discovery.document()
    health = {name: value.model_copy(update={"value": value.value * changes.get(name, 1.0)})
              for name, value in document.health.items()}  # fmt: skip
    (store.job_folder(job.id) / "result").mkdir()
    document.model_copy(update={"health": health}).write(store.job_folder(job.id) / "result" / "discrepancy.json")
    (store.job_folder(job.id) / "result" / "report.html").write_text("<p>report</p>")
    save(Outcome(sentence="The twin leaves out <b>something</b>."), store.job_folder(job.id) / "outcome.json")
    store.keep_state(job.id, JobState(status="done", started=now(), ended=now()))
    return job.id


def test_verdicts_have_a_history_and_are_compared(client: TestClient, recording: str) -> None:
    key = recording.rsplit("/", 1)[-1]
    first, second = finished(client, key), finished(client, key, A_egrmax=0.9)
    page = client.get(f"/jobs/{second}").text
    assert "largest effective EGR area" in page and "The twin leaves out &lt;b&gt;" in page
    report = client.get(f"/jobs/{second}/report")
    assert report.headers["content-security-policy"].startswith("sandbox") and "attachment" not in str(report.headers)
    assert "attachment" in client.get(f"/jobs/{second}/report.html").headers["content-disposition"]
    beside = client.get("/compare", params={"one": first, "other": second}).text
    assert beside.count(">0.00 %") == 3 and "−10.00 %" in beside and beside.count("differ</span>") == 1
    engine = client.get("/engines/we2011").text
    assert f'href="/jobs/{first}"' in engine and "<svg" in engine and "moved by −10.00 %" in engine
    assert client.post(f"/jobs/{second}/keep-engine").status_code == 404  # it repaired none
    assert client.get(f"/jobs/{second}/state").headers["hx-refresh"] == "true"
    assert "0123456789abcdef" not in client.post(f"/jobs/{first}/remove").text and first not in client.get("/").text


def test_an_engine_that_was_repaired_beside_a_learned_one_comes_with_what_was_learned(
    client: TestClient, recording: str
) -> None:
    job = finished(client, recording.rsplit("/", 1)[-1])
    result = desk_of(client).store.job_folder(job) / "result"
    (result / "engine.yaml").write_text("learned: engine.learned.parquet\n", encoding="utf-8")
    (result / "engine.learned.parquet").write_bytes(b"PAR1")
    page = client.get(f"/jobs/{job}").text
    assert f'href="/jobs/{job}/beside/engine.learned.parquet"' in page and "download both" in page
    assert client.get(f"/jobs/{job}/beside/engine.learned.parquet").content == b"PAR1"
    assert client.get(f"/jobs/{job}/beside/about.json").status_code == 404
    assert client.get(f"/jobs/{job}/beside/..%2fabout.json").status_code == 404
    client.post(f"/jobs/{job}/remove")


def test_several_recordings_are_judged_together_under_their_own_names(
    client: TestClient, recording: str, logger_csv: bytes, wait_for: Waiting
) -> None:
    paths = []
    for name in ("b 2026-03-14.csv", "a 2026-01-02.csv"):
        files = {"file": (name, logger_csv + b"\n" * len(paths))}
        paths.append(client.post("/recordings", files=files, follow_redirects=False).headers["location"])
        wait_for(paths[-1], "map-title")
    keys = [path.rsplit("/", 1)[-1] for path in paths]
    home = client.get("/").text
    assert "Judge several together" in home and all(f'name="together" value="{key}"' in home for key in keys)
    for wrong in ({"together": keys[:1], "engine": "we2011"}, {"together": keys, "engine": "none"},
                  {"together": [keys[0], keys[0]], "engine": "we2011"}):  # fmt: skip
        assert client.post("/recordings/ask-together", data=wrong).status_code == 422
    answer = client.post("/recordings/ask-together", data={"together": keys[::-1], "engine": "we2011"},
                         follow_redirects=False)  # fmt: skip
    path = answer.headers["location"]
    assert "What is left out of 2 recordings" in client.get(path).text
    page = wait_for(path, 'role="alert"')
    assert "b 2026-03-14.csv" in page and "share no driving" in page  # the same rows twice: people's names, in one line


def test_a_recording_is_taken_out_of_a_history_and_counts_again(client: TestClient, wait_for: Waiting) -> None:
    kept = desk_of(client).keep_engine("lorry 7", "learned", b"V_d: 0.0128\n", {})
    folder = desk_of(client).store.engine_folder(kept.id)
    store = History(folder / "history", "e" * 64)
    for k in range(3):
        store.add(entry(k))
    found = history(folder / "history")
    there = [{"sha256": one.sha256, "words": one.path} for one in found.entries]
    write_json(folder / "watched.json", sealed_json({"sentence": found.sentence, "alarm": True, "recordings": there,
                                                     "taken_out": []}))  # fmt: skip
    page, which = f"/engines/{kept.id}", entry(1).sha256
    calls = re.search(rf'href="/engines/{kept.id}">.*?</tr>', client.get("/engines").text, re.DOTALL)
    assert calls is not None and '<span class="tag check">1</span>' in calls.group(0)  # the history's alarm
    assert "Take it out" in client.get(page).text and "Let it count again" not in client.get(page).text
    for wrong in ({"recording": which, "reason": "  "}, {"recording": "f" * 64, "reason": "x"}, {"recording": which}):
        assert client.post(f"{page}/history", data=wrong).status_code == 422
    data = {"recording": which, "reason": "on <b>lorry 8</b>"}
    job = client.post(f"{page}/history", data=data, follow_redirects=False).headers["location"]
    assert "2 recordings" in wait_for(job, "Taken out: 1.csv")
    text = client.get(page).text
    assert "Let it count again" in text and "on &lt;b&gt;lorry 8" in text and "<b>lorry 8" not in text
    assert [one.path for one in store.entries()] == ["0.csv", "2.csv"]
    job = client.post(f"{page}/history", data={"recording": which}, follow_redirects=False).headers["location"]
    wait_for(job, "3 recordings")
    assert "Let it count again" not in client.get(page).text and len(store.entries()) == 3
    client.post(f"{page}/remove")


def test_an_uploaded_engine_is_read_and_can_be_chosen(
    client: TestClient, recording: str, wait_for: Waiting, workplace: Workplace
) -> None:
    files = [("yaml", ("../../truck.yaml", b"V_d: 0.0128\n"))]
    answer = client.post("/engines", files=files, follow_redirects=False)
    engine = answer.headers["location"]
    page = wait_for(engine, "Other than the published engine")
    assert "truck.yaml" in page and "0.0128" in page
    wait_for(recording, r"truck\.yaml \(uploaded\)")
    bad = client.post("/engines", files=[("yaml", ("bad.yaml", b"V_dd: 0.0128\n"))], follow_redirects=False)
    assert "V_dd" in wait_for(bad.headers["location"], 'role="alert"')
    assert "bad.yaml (" not in client.get(recording).text
    other = client.post("/engines", files=[("yaml", ("engine.exe", b"MZ"))])
    assert other.status_code == 422 and "engine.exe" in other.text
    names = {path.name for path in workplace.engines.rglob("*") if path.is_file()}
    assert names <= {"about.json", "uploaded.yaml", "engine.yaml", "details.json"}


def test_what_is_no_recording_is_said_in_one_line(client: TestClient, wait_for: Waiting) -> None:
    answer = client.post("/recordings", files={"file": ("report.pdf", b"%PDF-1.7\n" + bytes(100))},
                         follow_redirects=False)  # fmt: skip
    page = wait_for(answer.headers["location"], 'role="alert"')
    assert "report.pdf: got a PDF document" in page and "recording.bin" not in page
    assert client.post(f"{answer.headers['location']}/remove").status_code == 200
    assert client.get(answer.headers["location"]).status_code == 404
    assert "is empty" in client.post("/recordings", files={"file": ("nothing.csv", b"")}).text
    assert "No file came" in client.post("/recordings", data={"file": "text"}).text


def test_what_can_not_be_asked_is_refused(client: TestClient, recording: str) -> None:
    assert client.post(f"{recording}/ask", data={"kind": "delete", "engine": "we2011"}).status_code == 422
    assert client.post(f"{recording}/ask", data={"kind": "discover", "engine": "../../x"}).status_code == 422
    for number in ("inf", "nan", "1e400", "9" * 5000, "0", "2.5"):
        look = client.post(f"{recording}/look", data={"cylinders": number})
        assert look.status_code == 422 and "allowed: 1 to 32" in look.text
        form = {"channel-u_delta_mg": number}
        assert client.post(f"{recording}/map", data=form).status_code == 422
    for field in ("scale-p_im_pa", "offset-p_im_pa"):
        assert client.post(f"{recording}/map", data={"channel-p_im_pa": "1", field: "1e400"}).status_code == 422
    history = client.post(f"{recording}/ask", data={"kind": "watch", "engine": "we2011"})
    assert history.status_code == 422 and "belongs to an engine that was learned" in history.text
    assert client.post("/engines/learn", data={"name": "x", "engine": "we2011"}).status_code == 422
    assert client.get("/compare", params={"one": "x", "other": "y"}).status_code == 200
    assert client.get("/nothing").status_code == 404 and client.post("/").status_code == 405
