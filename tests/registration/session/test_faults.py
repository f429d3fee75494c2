"""A session that is killed, starved and lied to ends with the bytes of an undisturbed one, times left out."""

import signal
import time

import pytest

pytestmark = pytest.mark.slow


def test_killed_ten_times_it_ends_with_the_same_bytes(make_session, start, finish, results, tmp_path, rng):
    session = make_session(count=40)
    undisturbed, disturbed = tmp_path / "undisturbed", tmp_path / "disturbed"
    assert finish(session, undisturbed, 2, "local-pool", 2)[0] == 0
    counts = []
    for _ in range(10):
        process = start(session, disturbed, 2, "local-pool", 2, 20)
        for _ in range(int(rng.integers(1, 7))):
            if not process.stdout.readline():
                break
        time.sleep(rng.uniform(0, 0.03))
        process.send_signal(signal.SIGKILL)
        # The output ends only when the workers have ended too: none outlives its parent.
        process.communicate(timeout=30)
        assert process.returncode == -signal.SIGKILL
        counts.append(len(list((disturbed / "records").glob("*.npz"))))
    assert counts == sorted(counts) and 0 < counts[0] < 40
    assert not (disturbed / "session.json").exists()
    status, said = finish(session, disturbed, 3, "local-pool", 2)
    assert status == 0 and "damaged" not in said
    assert results(disturbed) == results(undisturbed)
    assert not list(disturbed.rglob("*.tmp"))
    assert finish(session, disturbed, 2, "local-pool", 2)[1] == "", "a finished session has nothing to do"


def test_stopped_by_ctrl_c_it_goes_on(make_session, start, finish, results, tmp_path):
    session = make_session()
    process = start(session, tmp_path / "reg", 2, "local-pool", 1, 200)
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=30)
    assert process.returncode != 0 and said.count("Traceback") == 1, "workers stay silent"
    assert 0 < len(list((tmp_path / "reg" / "records").glob("*.npz"))) < 24
    assert finish(session, tmp_path / "reg", 1)[0] == 0
    assert finish(session, tmp_path / "whole", 3)[0] == 0
    assert results(tmp_path / "reg") == results(tmp_path / "whole")


def test_a_lost_worker_costs_nothing_and_a_deadly_scan_one_row(make_session, finish, results, tmp_path):
    session, flag = make_session(), tmp_path / "flag"
    (session / "s05.txt").write_text(f"kill-once {flag}")
    (session / "s11.txt").write_text("kill")
    assert finish(session, tmp_path / "first", 3)[0] == 0
    assert flag.exists()
    assert finish(session, tmp_path / "second", 1)[0] == 0
    first, second = results(tmp_path / "first"), results(tmp_path / "second")
    assert first == second
    assert "its worker process was lost twice (exit code -9)" in first[0]["s11"][0]
    assert '"reason": "fine"' in first[0]["s05"][0]
    failed = [name for name, content in first[0].items() if '"status": "failed"' in content[0]]
    assert failed == ["s11"]
    assert finish(session, tmp_path / "first", 1)[1] == "", "the deadly scan is not tried again"


def test_a_scan_that_hangs_costs_one_row(make_session, finish, results, tmp_path):
    session = make_session(count=6)
    (session / "s01.txt").write_text("hang")
    assert finish(session, tmp_path / "reg", 2, "local-pool", 1, 0, 1.0)[0] == 0
    found, _ = results(tmp_path / "reg")
    assert "it took longer than 1 s" in found["s01"][0] and '"reason": "fine"' in found["s02"][0]


def test_a_deleted_scan_has_a_row_and_is_registered_when_it_is_back(make_session, finish, results, tmp_path):
    session = make_session()
    assert finish(session, tmp_path / "whole", 2)[0] == 0
    content = (session / "s07.txt").read_text()
    (session / "s07.txt").unlink()
    assert finish(session, tmp_path / "reg", 2)[0] == 0
    found, _ = results(tmp_path / "reg")
    assert '"status": "failed"' in found["s07"][0] and found["s07"][2] is None
    assert found["s08"] == results(tmp_path / "whole")[0]["s08"]
    (session / "s07.txt").write_text(content)
    status, said = finish(session, tmp_path / "reg", 2)
    assert status == 0 and "s07.txt: has changed" in said and said.count("done:") == 1
    assert results(tmp_path / "reg") == results(tmp_path / "whole")


@pytest.mark.parametrize("rounds", [1, 2])
def test_a_truncated_record_is_noticed_and_made_again(make_session, finish, results, tmp_path, rounds):
    session = make_session(count=12)
    for folder in ("whole", "reg"):
        assert finish(session, tmp_path / folder, 2, "local-pool", rounds)[0] == 0
    record = tmp_path / "reg" / "records" / "s03.npz"
    record.write_bytes(record.read_bytes()[:-100])
    status, said = finish(session, tmp_path / "reg", 2, "local-pool", rounds)
    assert status == 0 and "s03.npz: was damaged" in said and said.count("done: s03") == rounds
    assert results(tmp_path / "reg") == results(tmp_path / "whole")


def test_a_folder_that_cannot_be_written_is_named(make_session, finish, tmp_path):
    (tmp_path / "file").write_text("no folder")
    status, said = finish(make_session(count=2), tmp_path / "file" / "reg", 1)
    assert status == 2 and "error:" in said and "file" in said and "cannot be written" in said
    assert "Traceback" not in said


def test_dask_agrees_with_the_local_pool(make_session, finish, results, tmp_path):
    session = make_session(count=12)
    assert finish(session, tmp_path / "pool", 2, "local-pool", 2)[0] == 0
    status, said = finish(session, tmp_path / "dask", 2, "dask", 2)
    assert status == 0, said
    assert results(tmp_path / "dask") == results(tmp_path / "pool")
