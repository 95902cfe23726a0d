from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def _own_sockets(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    folder: Path = tmp_path_factory.mktemp("bus")
    folder.chmod(0o700)
    monkeypatch.setenv("SKIN_BUS_DIR", str(folder))
