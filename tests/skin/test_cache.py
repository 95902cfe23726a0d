"""The cache folder."""

from pathlib import Path

from skin.cache import cache_folder


def test_cache_folder_follows_the_environment() -> None:
    assert cache_folder({"SKIN_CACHE": "/a", "XDG_CACHE_HOME": "/b"}) == Path("/a")
    assert cache_folder({"XDG_CACHE_HOME": "/b"}) == Path("/b/canskin")
    assert cache_folder({}) == Path.home() / ".cache" / "canskin"
