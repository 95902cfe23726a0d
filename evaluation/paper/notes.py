"""Notes that several tables share."""

from typing import Final

from evaluation.findings import Options
from touch.trajectory import ACQUISITION_OBJECTS

CONVENTION: Final = (
    "½‖ΦΨs - y‖² + λ‖s‖₁ with Φ of ±1, forces in newtons, L twice the largest eigenvalue of (ΦΨ)ᵀΦΨ, the momentum "
    "begun anew and the coefficients kept from step to step, negative taxels set to 0 at the end. For noiselets λ = 1 "
    "as printed. For SBHE the printed λ = 0.1, measured once, fits no table; λ = 0.01 is used, fitted once to the SBHE "
    "cells of Table II (of 0.003 to 0.03), where it served Haar and contourlets alike: perhaps a misprint."
)


def objects_note(options: Options) -> str:
    """Return what the trajectories are made of, and which of their starts are fitted."""
    fitted = [name for name, start in ACQUISITION_OBJECTS.items() if not start.exact]
    starts = (
        f"The starts of {', '.join(fitted)} are not published: they are fitted to the Haar, D4 and DCT rows of the "
        "paper's Table I; that of the golf ball is exact."
    )
    if options.meshes:
        return f"Drill, cup and clamp are made from the meshes of '{options.meshes.name}'. {starts}"
    return (
        "Drill, cup and clamp are our own shapes, which only resemble the paper's objects: their differences are those "
        f"of the shapes too. Give --meshes for the paper's. {starts}"
    )


def quick_note(options: Options) -> list[str]:
    """Return the warning that belongs to a quick look."""
    if not options.quick:
        return []
    return [
        (
            "A quick look: few steps, far apart, so that each start is a poorer one than the paper's, and few "
            "iterations do not make up for it: what is counted above does not judge the tables."
        )
    ]
