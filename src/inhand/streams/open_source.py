"""What the user names on the command line, as a source."""

from pathlib import Path

from inhand.errors import InputError
from inhand.streams.bag import is_recording, need_rosbags
from inhand.streams.bop_scene import BopScene, has_scenes
from inhand.streams.config import StreamConfig
from inhand.streams.folder import Folder, is_folder_of_images
from inhand.streams.realsense import RealSense
from inhand.streams.source import Source

CAMERA = "realsense"


def open_source(name: str, config: StreamConfig) -> Source:
    """Open a folder of images, a scene of a data set, a recording or a camera.

    Args:
        name: a path; or `realsense`, or `realsense:SERIAL`.
        config: what to take of it.

    Raises:
        InputError: there is no such source, it lacks what is needed, or leaves a choice.
    """
    kind, _, serial = name.partition(":")
    if kind != CAMERA and is_recording(Path(name)):
        need_rosbags()
        from inhand.streams.recording import Recording

        return Recording(Path(name), config)
    if config.chosen_for_recordings:
        options = ", ".join(config.chosen_for_recordings)
        raise InputError(f"{name} is no recording, for which alone there is: {options}")
    if kind == CAMERA:
        return RealSense(serial, config)
    path = Path(name)
    if not path.exists():
        raise InputError(f"there is no file or folder {path}; a camera is called {CAMERA}")
    if has_scenes(path):
        return BopScene(path, config)
    if is_folder_of_images(path):
        return Folder(path, config)
    raise InputError(
        f"{path} is no source: expected a folder of depth images (with camera.json), a scene of a "
        f"BOP data set, a ROS 1 bag (.bag), a ROS 2 bag (a folder, .db3 or .mcap) or {CAMERA}"
    )
