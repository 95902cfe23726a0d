"""Images, contacts and labels of a canskin robot skin, for programs.

Examples
--------
>>> import canskin
>>> with canskin.connect() as skin:
...     print(skin.latest().contacts)
"""

from canskin.application import export_model, labelled_touches, simulate
from canskin.connection import connect, skins_at
from canskin.description import Description
from canskin.errors import BusError, InputError, RunError, SkinError
from canskin.frame import Frame
from canskin.messages import Contact, EndedContact
from canskin.skin import Frames, Health, Skin

__all__ = [
    "BusError",
    "Contact",
    "Description",
    "EndedContact",
    "Frame",
    "Frames",
    "Health",
    "InputError",
    "RunError",
    "Skin",
    "SkinError",
    "connect",
    "export_model",
    "labelled_touches",
    "simulate",
    "skins_at",
]
