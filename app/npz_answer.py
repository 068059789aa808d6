"""An answer as an NPZ archive, which costs neither side any parsing of numbers."""

from __future__ import annotations

import io
import json

import numpy as np
from fastapi import Response

from app.request_body import NPZ
from app.schemas import RegisterResponse


def npz_answer(answer: RegisterResponse) -> Response:
    """The pose as arrays, and the whole answer as JSON text in the array ``answer``."""
    text = json.dumps(answer.document(), allow_nan=False, separators=(",", ":"))
    archive = io.BytesIO()
    np.savez(
        archive,
        T_target_source=np.array(answer.T_target_source),
        quaternion_xyzw=np.array(answer.quaternion_xyzw),
        translation=np.array(answer.translation),
        covariance=np.array(answer.diagnostics.covariance),
        answer=np.frombuffer(text.encode(), np.uint8),
    )
    return Response(archive.getvalue(), media_type=NPZ)
