"""The options of a run, checked before any process is started."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter

from bus.options import virtual_bit_rates
from canskin.errors import InputError
from canskin.session import DEFAULT_ENDPOINT
from demo.rate import at_rate
from reconstructor.options import SolverOptions
from shell.output import PICTURE_SUFFIXES, check_output_path
from shell.service import listen
from shell.skin_options import Insecure, check_listen
from shell.touch_options import NO_TOUCH_OPTIONS, TouchOptions
from skin.layout import Layout, require_sending
from skin.ranges import require_above_zero


@Parameter(name="*")
@dataclass(frozen=True)
class DemoOptions:
    """The options of ``skin demo``.

    Attributes
    ----------
    layout
        TOML of the skin; without it the default skin of 64 x 64 taxels on four CAN buses. Of several skins: one for
        each, which share a hub and a page.
    seconds
        Time that SYNC runs, seconds.
    touch
        What touches the skin. With defects that move the zero the touches begin when the zero has been measured.
    view
        ``--no-view`` runs without web page.
    port
        Port of the web page, 0 for a free port; default 8765, or a free port if 8765 is in use.
    listen
        Endpoint of the fabric's hub for other programs; default: a socket that only this user may open.
    insecure
        See ``skin gateway``.
    classify
        ``--no-classify`` runs without classifier, for example to record touches of own objects: no model is trained.
    model
        Model file from ``skin train`` for this skin, in place of a model of the objects that touch. A model for
        means of cycles (`docs/classification.md`, "Averages") is for one rate, which the run keeps.
    picture
        File for the picture of true force, one raw sample, rebuilt image and error.
    solver
        Solver of the images, see ``skin reconstruct``.
    sync_rate
        SYNC rate, hertz, with as many samples in a cycle as the layout has. Default: the layout's; where too few cycles
        are complete in the first seconds of a run of 10 s or longer, half of it, at the least an eighth.
    firmware
        Run the C firmware of the boards in place of nodes in Python, see ``skin nodes``.
    """

    layout: Annotated[list[Path], Parameter(negative=(), show_default=False)] = field(default_factory=list)
    seconds: float = 20.0
    touch: TouchOptions = NO_TOUCH_OPTIONS
    view: bool = True
    port: int | None = None
    listen: str | None = None
    insecure: Insecure = False
    classify: bool = True
    model: Path | None = None
    picture: Annotated[Path, Parameter(name=("--figure", "--picture"))] = Path("skin-demo.png")
    solver: SolverOptions | None = None
    sync_rate: float | None = None
    firmware: Annotated[bool, Parameter(negative=())] = False

    def of_skin(self, place: int, name: str) -> "DemoOptions":
        """Return the options of one of several skins, by its place among the layouts: the first run has the page."""
        picture = self.picture.with_name(f"{self.picture.stem}-{name}{self.picture.suffix}")
        return replace(self, layout=[self.layout[place]], view=self.view and place == 0, picture=picture)

    def has_zero_errors(self, layout: Layout) -> bool:
        """Tell whether taxels may read something without touch, apart from noise, so that the gateway has to tare."""
        return self.touch.input is not None or self.touch.defects(layout).moves_zero

    def check(self, layout: Layout) -> None:
        """Raise InputError unless a run with these options is possible."""
        require_above_zero("--seconds", self.seconds)
        check_listen(self.listen or DEFAULT_ENDPOINT, insecure=self.insecure)
        virtual_bit_rates(layout)
        if self.sync_rate is not None:
            require_sending(layout, "synchronous", "--sync-rate is", "stepped boards send as they have news")
            layout = at_rate(layout, self.sync_rate)
        if self.view and self.port is not None:
            listen("127.0.0.1", self.port).close()
        check_output_path(self.picture, "picture", *PICTURE_SUFFIXES)
        if self.model is not None:
            if not self.classify:
                raise InputError("--model is for the classifier: leave --no-classify out")
            from classifier.modelfile import load_model  # compiled parts take a moment to load
            from classifier.used_sums import classified_phi

            load_model(self.model, layout, classified_phi(layout))
        if self.solver is not None:
            self.solver.check(layout)
        self.touch.check()
        self.touch.defects(layout)
        if self.touch.input is not None:
            self.touch.source(layout)  # the nodes will read the recording again
        elif self.touch.names:
            from touch.objects import checked_names  # compiled parts take a moment to load

            checked_names(self.touch.names)


DEFAULTS: Final = DemoOptions()
