"""``picture.png``: the picture of the last step, drawn at the end of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pdpetsc.discrete.communicator import agreed, is_root, total
from pdpetsc.errors import described
from pdpetsc.output.folder import set_pictures_aside
from pdpetsc.output.observer import Observed, Observer, StepRecords
from pdpetsc.output.picture import draw_field
from pdpetsc.output.progress import Report
from pdpetsc.output.scene import Settings, component_of
from pdpetsc.petsc.stages import OUTPUT, stage
from pdpetsc.post.picture import Picture, refuse_empty, uncut
from pdpetsc.post.solution import Solution


class FinalPicture(Observer):
    """Draw the declared picture, if any, and move earlier pictures aside."""

    def __init__(self, picture: Picture | None) -> None:
        self._picture = picture

    def rehearse(self, start: Solution, report: Report) -> None:
        """Raise CaseError for a component that the field does not have, and for cuts that leave nothing."""
        if self._picture is None:
            return
        axes = np.ndim(self._picture.field(start)) - 1
        with agreed(start.cloud.comm):
            component_of(np.empty((0, *axes * [3])), self._picture.component)
        left = uncut(start.x, self._picture.cuts)
        refuse_empty(self._picture.cuts, int(total(start.cloud.comm, left.sum())))

    def begin(self, observed: Observed) -> None:
        """Move earlier pictures aside at a restart in the same folder."""
        super().begin(observed)
        if observed.in_own_folder:
            set_pictures_aside(observed.comm, observed.folder)

    def summary(self, steps: StepRecords) -> Mapping[str, Any]:
        """Return the settings of the picture, for later pictures of the run."""
        shown = self._picture
        if shown is None:
            return {}
        what = {"field": shown.field.__name__, "component": shown.component, "scale": shown.scale}
        return {"picture": {**what, "cut": [list(cut) for cut in shown.cuts]}}

    def finish(self) -> None:
        """Draw the picture; a failure is only a warning."""
        folder, report, shown = self.observed.folder, self.observed.report, self._picture
        if shown is not None and is_root(self.observed.comm):
            path = folder / "picture.png"
            settings = Settings(shown.field.__name__, shown.component, shown.scale, shown.cuts)
            with stage(OUTPUT):
                try:
                    draw_field(folder, path, settings)
                    report.say(f"picture in {path}")
                except Exception as error:
                    report.warn(f"The run is finished, but its picture could not be drawn: {described(error)}")
