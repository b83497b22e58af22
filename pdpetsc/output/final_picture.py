"""``picture.png``: the picture of the last step, drawn at the end of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pdpetsc.discrete.communicator import agreed, is_root
from pdpetsc.errors import described
from pdpetsc.output.folder import set_pictures_aside
from pdpetsc.output.observer import Observed, Observer, StepRecords
from pdpetsc.output.picture import draw_field
from pdpetsc.output.progress import Report
from pdpetsc.output.scene import component_of
from pdpetsc.petsc.stages import OUTPUT, stage
from pdpetsc.post.picture import Picture
from pdpetsc.post.solution import Solution


class FinalPicture(Observer):
    """Draws the declared picture, if there is one; earlier pictures of the folder are set aside."""

    def __init__(self, picture: Picture | None) -> None:
        self._picture = picture

    def rehearse(self, start: Solution, report: Report) -> None:
        """Refuse a component that the field does not have."""
        if self._picture is None:
            return
        axes = np.ndim(self._picture.field(start)) - 1
        with agreed(start.cloud.comm):
            component_of(np.empty((0, *axes * [3])), self._picture.component)

    def begin(self, observed: Observed) -> None:
        """Move pictures of the run before a restart in the same folder away."""
        super().begin(observed)
        if observed.in_own_folder:
            set_pictures_aside(observed.comm, observed.folder)

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        """Return what the picture shows, for later pictures of the run."""
        shown = self._picture
        if shown is None:
            return {}
        return {"picture": {"field": shown.field.__name__, "component": shown.component, "scale": shown.scale}}

    def finish(self) -> None:
        """Draw the picture; the results stand if that fails."""
        folder, report, picture = self.observed.folder, self.observed.report, self._picture
        if picture is not None and is_root(self.observed.comm):
            path = folder / "picture.png"
            with stage(OUTPUT):
                try:
                    draw_field(folder, path, picture.field.__name__, picture.component, picture.scale, folder.name)
                    report.say(f"picture in {path}")
                except Exception as error:
                    report.warn(f"The run is finished, but its picture could not be drawn: {described(error)}")
