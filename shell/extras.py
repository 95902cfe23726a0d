"""Optional dependencies."""

from canskin.errors import InputError


def not_installed(why: str, extra: str) -> InputError:
    """Return the error for a package that cannot be imported.

    Parameters
    ----------
    why : str
        What needs which package.
    extra : str
        Name of the extra, in `pyproject.toml`, that installs the package.
    """
    return InputError(f'{why}: in a clone of canskin, pip install ./client ".[{extra}]"')
