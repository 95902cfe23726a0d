"""The request for images of a skin that recognises first."""

from typing import Final

import msgspec

from canskin.question import Question


class ImagesRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Asks for images from now on, for `hold_s` seconds.

    Images come until the end of the request that ends last: a shorter one does not end a longer one.
    """

    hold_s: float


class ImagesReply(msgspec.Struct, frozen=True, kw_only=True):
    """The gateway's answer: whether images come, and the reason if they do not."""

    is_done: bool
    text: str = ""


#: The gateway answers at once; images come from the second cycle on.
IMAGES: Final = Question("images", ImagesRequest, ImagesReply)
#: Longest time for which one request holds.
MOST_HOLD_S: Final = 3600.0
