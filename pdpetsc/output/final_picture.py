"""``picture.png``: the picture of the last step, drawn at the end of a run."""

from __future__ import annotations

import numpy as np

from pdpetsc.discrete.communicator import agreed, is_root
from pdpetsc.errors import CaseError, described
from pdpetsc.output.folder import set_pictures_aside
from pdpetsc.output.observer import Observed, Observer
from pdpetsc.output.picture import Picture, draw
from pdpetsc.output.progress import Report
from pdpetsc.petsc.stages import OUTPUT, stage
from pdpetsc.post.solution import Solution


class FinalPicture(Observer):
    """Draws the declared picture, if there is one; earlier pictures of the folder are set aside."""

    def __init__(self, picture: Picture | None) -> None:
        self._picture = picture

    def rehearse(self, start: Solution, report: Report) -> None:
        """Refuse a component that the field does not have."""
        if self._picture is None:
            return
        rank, component = np.ndim(self._picture.field(start)), self._picture.component
        with agreed(start.cloud.comm):
            if len(component) != rank - 1 or any(letter not in "xyz" for letter in component):
                known = ("empty", "x, y or z", "xx, xy, ...")[rank - 1]
                raise CaseError(f"A component of the picture's field is {known}, not {component!r}.")

    def begin(self, observed: Observed) -> None:
        """Move pictures of the run before a restart in the same folder away."""
        super().begin(observed)
        if observed.in_own_folder:
            set_pictures_aside(observed.comm, observed.folder)

    def finish(self) -> None:
        """Draw the picture; the results stand if that fails."""
        folder, report = self.observed.folder, self.observed.report
        if self._picture is not None and is_root(self.observed.comm):
            with stage(OUTPUT):
                try:
                    report.say(f"picture in {draw(folder, self._picture, folder.name)}")
                except Exception as error:
                    report.warn(f"The run is finished, but its picture could not be drawn: {described(error)}")
