"""Uses a real Cura 4.13 from within, as one of its plugins: printer, model, our script, slicing, saving.

No test: `test_slicers.py` puts it among Cura's plugins and starts Cura without windows (`cura --headless`). What to do
is a JSON file, `CURA_JOB`; what was seen is written beside it, `seen.json`.
"""

from __future__ import annotations

import json
import os
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from PyQt5.QtCore import QTimer, QUrl
from PyQt5.QtWidgets import QFileDialog
from UM.Backend.Backend import BackendState
from UM.Extension import Extension
from UM.Math.Vector import Vector
from UM.PluginRegistry import PluginRegistry

LOOK_MS = 50  # between steps Cura goes on with its own work
SETTLED_S = 1.0  # Cura waits for half a second for more changes, and then forgets what was sliced before


def getMetaData() -> dict[str, Any]:
    return {}


def register(app: Any) -> dict[str, Any]:
    return {"extension": Driver(app)}


class Driver(Extension):
    """Begins when Cura is ready, and ends it."""

    def __init__(self, app: Any) -> None:
        super().__init__()
        self.steps = _steps(app, Path(os.environ["CURA_JOB"]))
        app.initializationFinished.connect(self.go_on)

    def go_on(self) -> None:
        try:
            next(self.steps)
            QTimer.singleShot(LOOK_MS, self.go_on)
        except StopIteration:
            os._exit(0)
        except Exception:
            traceback.print_exc()
            os._exit(1)


def _steps(app: Any, path: Path) -> Iterator[None]:
    """All that a user would do; each `yield` waits a little."""
    job, scripts = json.loads(path.read_text(encoding="utf-8")), _scripts()
    app.getMachineManager().addMachine(job["printer"], "the printer")
    yield from _open(app, job["model"])
    for save in job["saves"]:
        if "settings" in save:
            _choose(scripts, save["settings"])
            yield from _slice(app)
        yield from _save(app, save["to"])
    seen = {
        "label": scripts.getScriptLabelByKey("Ffcomp"),
        "said": [message.getText() for message in app.getVisibleMessages() if message.getTitle() == "ffcomp"],
    }
    path.with_name("seen.json").write_text(json.dumps(seen), encoding="utf-8")


def _scripts() -> Any:
    """The plugin for post-processing, which has looked for scripts."""
    plugin = PluginRegistry.getInstance().getPluginObject("PostProcessingPlugin")
    plugin.loadAllScripts()
    return plugin


def _open(app: Any, model: str) -> Iterator[None]:
    app.readLocalFile(QUrl.fromLocalFile(model))
    nodes: list[Any] = []
    while not nodes:
        yield
        nodes = [node for node in app.getController().getScene().getRoot().getAllChildren() if _sliceable(node)]
    for node in nodes:  # without a window Cura puts them beside the bed
        node.setPosition(Vector(0, node.getPosition().y, 0))


def _sliceable(node: Any) -> bool:
    return bool(node.callDecoration("isSliceable"))


def _choose(scripts: Any, settings: dict[str, str]) -> None:
    """Our script alone, with settings that Cura has stored with the printer and read again."""
    while scripts.scriptList:
        scripts.removeScriptByIndex(0)
    scripts.addScriptToList("Ffcomp")
    for key, value in settings.items():
        scripts._script_list[0]._instance.setProperty(key, "value", value)
    scripts.writeScriptsToStack()
    scripts._restoreScriptInforFromMetadata()


def _slice(app: Any) -> Iterator[None]:
    settled = time.monotonic() + SETTLED_S
    while time.monotonic() < settled:
        yield
    backend, scene = app.getBackend(), app.getController().getScene()
    backend.forceSlice()
    while backend._backend_state != BackendState.Done or not scene.gcode_dict.get(0):
        yield


def _save(app: Any, path: str) -> Iterator[None]:
    """As the button does it, with an answer to the window that asks for a name; what was sliced goes beside."""
    scene, device = app.getController().getScene(), app.getOutputDeviceManager().getOutputDevice("local_file")
    Path(f"{path}.sliced").write_text("".join(scene.gcode_dict[0]), encoding="utf-8")

    def answer(dialog: QFileDialog) -> int:
        dialog.selectNameFilter("G-code File (*.gcode)")
        dialog.selectFile(path)
        return 1

    QFileDialog.exec_ = answer
    device.requestWrite(scene.getRoot(), "print", None, None)
    while device._writing:
        yield
