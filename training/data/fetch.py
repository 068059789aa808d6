"""Public data sets from their official addresses: resumable, checked, safely unpacked."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

from model.exceptions import InvalidOptionError
from training.data.download import DownloadError, download, network_problem
from training.data.unpack import unpack

Progress = Callable[[str, int, int | None], None]

GIGABYTE = 10**9
_ETH3D = "https://www.eth3d.net/data/slam"
_LIST_TIMEOUT = 30.0


@dataclass(frozen=True, slots=True)
class Archive:
    """A file to download.

    Attributes:
        url: its official address.
        md5: hexadecimal, or None where nobody publishes one; ZIP's own checksums hold anyway.
    """

    url: str
    md5: str | None = None

    @property
    def filename(self) -> str:
        """The last part of the address."""
        return self.url.rpartition("/")[2]


@dataclass(frozen=True, slots=True)
class Dataset:
    """A folder that some archives unpack to.

    Attributes:
        name: what people call it.
        folder: the archives' only folder at the top.
        archives: all of them.
        unpacked_bytes: refuse to unpack more than this.
    """

    name: str
    folder: str
    archives: Sequence[Archive]
    unpacked_bytes: int


DATASETS = {
    "modelnet40": Dataset(
        "ModelNet40",
        "ModelNet40",
        (Archive("https://modelnet.cs.princeton.edu/ModelNet40.zip"),),
        15 * GIGABYTE,
    ),
    "modelnet10": Dataset(
        "ModelNet10",
        "ModelNet10",
        (Archive("https://3dvision.princeton.edu/projects/2014/3DShapeNets/ModelNet10.zip"),),
        5 * GIGABYTE,
    ),
    "modelnet40-hdf5": Dataset(
        "ModelNet40 (2048 points)",
        "modelnet40_ply_hdf5_2048",
        (
            Archive(
                "https://shapenet.cs.stanford.edu/media/modelnet40_ply_hdf5_2048.zip",
                "c9ab8e6dfb16f67afdab25e155c79e59",
            ),
        ),
        2 * GIGABYTE,
    ),
}


def eth3d_sequence(name: str) -> Dataset:
    """One sequence; depth comes in one archive, calibration and ground truth in the other."""
    archives = [Archive(f"{_ETH3D}/datasets/{name}_{kind}.zip") for kind in ("mono", "rgbd")]
    return Dataset(f"ETH3D {name}", name, archives, 20 * GIGABYTE)


def eth3d_sequences(
    out: Path, names: Sequence[str] | None, list_url: str = f"{_ETH3D}/dataset_list_training.txt"
) -> list[Dataset]:
    """The sequences asked for, or all that ETH3D lists for training.

    Args:
        out: where they will go; named in the error.
        names: of the sequences, or None for all.
        list_url: the official list.

    Raises:
        DownloadError: the list can't be read.
        InvalidOptionError: a name that can't be one.
    """
    if names is None:
        try:
            with urlopen(list_url, timeout=_LIST_TIMEOUT) as answer:
                names = answer.read().decode().split()
        except (URLError, OSError, ValueError) as error:
            raise DownloadError(
                f"the list of sequences can't be read: {network_problem(error)}",
                field="eth3d",
                value=list_url,
                mend=f"download the sequences elsewhere and unpack them to {out}, "
                "or name them with --sequence",
            ) from error
    strange = [name for name in names if not name.replace("_", "").isalnum()]
    if strange:
        raise InvalidOptionError(
            "isn't the name of a sequence", field="sequence", value=", ".join(strange),
            mend="give names as in www.eth3d.net/slam_datasets, like sofa_1",
        )  # fmt: skip
    return [eth3d_sequence(name) for name in names]


def fetch(dataset: Dataset, out: Path, progress: Progress = lambda name, done, total: None) -> Path:
    """Download, check and unpack a data set; what is there already is left alone.

    Args:
        dataset: which.
        out: the folder to put its folder into; the archives need as much room meanwhile.
        progress: called with a file's name, the bytes done and, where known, all its bytes.

    Returns:
        The data set's folder.

    Raises:
        DownloadError: offline, refused, damaged or unsafe; it says what to do by hand.
    """
    place = out / dataset.folder
    if place.is_dir():
        return place
    downloads = out / ".downloads"
    downloads.mkdir(parents=True, exist_ok=True)
    by_hand = (
        f"or download {' and '.join(archive.url for archive in dataset.archives)} elsewhere and "
        f"unpack to {place}"
    )
    files = []
    for archive in dataset.archives:
        file = downloads / archive.filename
        download(archive.url, file, progress, by_hand)
        _require_checksum(file, archive, by_hand)
        files.append(file)
    unfinished = downloads / f"{dataset.folder}.unpacking"
    shutil.rmtree(unfinished, ignore_errors=True)
    left = dataset.unpacked_bytes
    for file in files:
        left -= unpack(file, unfinished, left)
    if not (unfinished / dataset.folder).is_dir():
        raise DownloadError(
            f"the archive has no folder {dataset.folder}", field=dataset.name, value=str(files[0])
        )
    (unfinished / dataset.folder).rename(place)
    shutil.rmtree(unfinished)
    for file in files:
        file.unlink()
    return place


def _require_checksum(file: Path, archive: Archive, by_hand: str) -> None:
    if archive.md5 is None:
        return
    with file.open("rb") as stream:
        found = hashlib.file_digest(stream, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()
    if found != archive.md5:
        file.unlink()
        raise DownloadError(
            "the download is damaged and was deleted: its MD5 sum is wrong",
            field=archive.url,
            value=found,
            mend=f"try again, {by_hand}",
        )
