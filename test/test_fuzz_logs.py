"""Hostile logs and mappings: they are read or refused, in bounded memory; see test_fuzz."""

from __future__ import annotations

import json
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import small_arm
import yaml
from fuzzing import EXAMPLES, ends_well, in_child
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat
from test_fuzz import ODD, places, with_value
from test_fuzz_bags import DAMAGE, damaged

from spacearm_ident.errors import UserError
from spacearm_ident.logs.read import recording_by
from spacearm_ident.logs.words import meaning_of
from spacearm_ident.recording.log_mapping import read_mapping
from spacearm_ident.recording.tables import read_table

RUN = small_arm.recording(0.5)
ARRAYS = {"t": RUN.time, "q": RUN.position, "tau": RUN.effort}


def sound(kind: str, folder: Path) -> Path:
    """A sound log of each kind."""
    path = folder / f"log.{kind}"
    match kind:
        case "csv":
            rows = np.column_stack(list(ARRAYS.values()))
            path.write_text("t,q1,q2,tau1,tau2\n" + "\n".join(",".join(map(str, row)) for row in rows))
        case "npz":
            np.savez_compressed(path, **ARRAYS)
        case "mat":
            savemat(path, {"log": ARRAYS, "t": RUN.time}, do_compression=True)
        case "h5":
            import h5py

            with h5py.File(path, "w") as file:
                for name, array in ARRAYS.items():
                    file.create_dataset(f"robot/{name}", data=array, compression="gzip")
        case "parquet":
            import pyarrow
            from pyarrow import parquet

            columns = {"t": RUN.time, "q": list(RUN.position), "tau": list(RUN.effort)}
            parquet.write_table(pyarrow.table(columns), path)
    return path


@pytest.mark.parametrize("kind", ["csv", "npz", "mat"])
def test_a_damaged_log_is_read_or_refused(kind, tmp_path):
    whole = sound(kind, tmp_path).read_bytes()
    target = tmp_path / f"hurt.{kind}"

    @EXAMPLES
    @given(damage=DAMAGE)
    def attack(damage):
        target.write_bytes(damaged(whole, damage))
        table = ends_well(lambda: read_table(target))
        assert table is None or table.rows >= 2

    attack()


@pytest.mark.parametrize(("kind", "package"), [("h5", "h5py"), ("parquet", "pyarrow")])
def test_a_damaged_log_of_a_c_library_is_read_or_refused(kind, package):
    """In one child, for the parsers are C: what kills it fails the test."""
    if find_spec(package) is None:
        pytest.skip(f"needs {package}")
    code = f"""
        import sys, tempfile
        from pathlib import Path
        sys.path[:0] = {[*sys.path]!r}
        import test_fuzz_logs
        with tempfile.TemporaryDirectory() as folder:
            test_fuzz_logs.test_a_damaged_log_is_read_or_refused({kind!r}, Path(folder))
        print("survived")
    """
    assert in_child(code, gigabytes=4.0, seconds=600) == "survived"


@EXAMPLES
@given(
    text=st.text(max_size=300)
    | st.lists(st.sampled_from([*"0123456789.,;\t \n-eE#\"'%", "nan", "inf", "\r\n", "q1", "1e400"])).map("".join),
)
def test_any_text_is_a_table_or_refused(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8", errors="replace")
    ends_well(lambda: read_table(path))


@EXAMPLES
@given(name=st.text(max_size=60))
def test_any_name_of_a_column_means_something_or_nothing(name):
    meaning_of(name)


def mapping() -> dict[str, object]:
    """A sound mapping of the sound logs."""
    columns = [{"position": f"q{k}", "effort": f"tau{k}"} for k in (1, 2)]
    return {
        "schema": "spacearm_ident/log_mapping/1",
        "arm": "arm.urdf",
        "time": {"column": "t", "unit": "s"},
        "units": {"position": "rad", "effort": "A"},
        "joints": dict(zip(small_arm.JOINTS, columns)),
        "effort_constants": {"shoulder": 10, "elbow": 5},
        "counts_per_turn": {"shoulder": 4096},
    }


def test_a_mapping_with_anything_anywhere_is_read_or_refused(tmp_path):
    document = mapping()
    everywhere = places(document)
    (tmp_path / "arm.urdf").write_text(small_arm.URDF)
    table = read_table(sound("csv", tmp_path))
    file = tmp_path / "log.csv.mapping.yaml"

    def use():
        read = read_mapping(file)
        return recording_by(table, read, tmp_path / "arm.urdf", "log")

    file.write_text(yaml.safe_dump(document))
    assert len(use().time) == table.rows

    @EXAMPLES
    @given(st.data())
    def attack(data):
        bad = with_value(document, data.draw(st.sampled_from(everywhere)), data.draw(ODD))
        file.write_text(yaml.safe_dump(bad), encoding="utf-8")
        ends_well(use)

    attack()


# --- what is small and says it is large ---------------------------------------------------------------------


def test_archives_that_announce_more_than_they_hold_take_no_room(tmp_path):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (40000000000,), }"
    header += b" " * (64 - (len(header) + 11) % 64) + b"\n"
    with zipfile.ZipFile(tmp_path / "log.npz", "w") as archive:
        archive.writestr("q.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(UserError, match="announces"):
        read_table(tmp_path / "log.npz")
    savemat(tmp_path / "log.mat", {"q": np.zeros(30_000_000)}, do_compression=True)
    assert (tmp_path / "log.mat").stat().st_size < 300_000
    code = f"""
        from pathlib import Path
        from spacearm_ident.recording.tables import read_table, table
        from spacearm_ident.errors import UserError
        table.MAX_TABLE_BYTES = 2**26
        try:
            read_table(Path({str(tmp_path / "log.mat")!r}))
        except UserError as error:
            print("refused", error)
    """
    assert in_child(code).startswith("refused")


def test_nothing_pickled_is_loaded(tmp_path):
    np.savez(tmp_path / "log.npz", t=np.arange(5.0), q=np.array([{"a": 1}] * 5, dtype=object))
    with pytest.raises(UserError, match="cannot be read"):
        read_table(tmp_path / "log.npz")


def test_hdf5_links_to_other_files_are_left_alone(tmp_path):
    h5py = pytest.importorskip("h5py", reason="needs h5py")
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["q"] = np.arange(9.0)
    (tmp_path / "raw").write_bytes(bytes(800))
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["t"] = np.arange(9.0)
        file["link"] = h5py.ExternalLink(str(secret), "/q")
        file.create_dataset("outside", (9,), "f8", external=[(str(tmp_path / "raw"), 0, 72)])
        layout = h5py.VirtualLayout((9,), "f8")
        layout[:] = h5py.VirtualSource(str(secret), "q", (9,))
        file.create_virtual_dataset("virtual", layout)
    assert set(read_table(tmp_path / "log.h5").columns) == {"t"}


@pytest.mark.parametrize("version", [2, 3])
def test_a_lerobot_dataset_whose_description_holds_anything_is_read_or_refused(version, tmp_path):
    pyarrow = pytest.importorskip("pyarrow", reason="needs pyarrow")
    from pyarrow import parquet

    rows = len(RUN.time)
    features = {
        "observation.state": {"dtype": "float64", "shape": [2], "names": ["shoulder.pos", "elbow.pos"]},
        "observation.effort": {"dtype": "float64", "shape": [2], "names": {"motors": ["shoulder", "elbow"]}},
    }
    info = {"codebase_version": f"v{version}.0", "fps": 100.0, "features": features, "total_episodes": 1}
    columns = {
        "observation.state": list(RUN.position),
        "observation.effort": list(RUN.effort),
        "frame_index": np.arange(rows),
        "episode_index": np.zeros(rows, dtype=int),
    }
    name = "episode_000000.parquet" if version == 2 else "file-000.parquet"
    (tmp_path / "data" / "chunk-000").mkdir(parents=True)
    (tmp_path / "meta").mkdir()
    parquet.write_table(pyarrow.table(columns), tmp_path / "data" / "chunk-000" / name)
    file = tmp_path / "meta" / "info.json"
    file.write_text(json.dumps(info))
    assert read_table(tmp_path).rows == rows
    everywhere = places(info)

    @EXAMPLES
    @given(st.data())
    def attack(data):
        bad = with_value(info, data.draw(st.sampled_from(everywhere)), data.draw(ODD))
        file.write_text(json.dumps(bad, default=str), encoding="utf-8")
        table = ends_well(lambda: read_table(tmp_path))
        assert table is None or table.rows == rows

    attack()
    for text in ("", "[", "null", '{"fps": 1e999}', '{"fps": -5}', "[" * 100_000):
        file.write_text(text)
        ends_well(lambda: read_table(tmp_path))
