# Copyright 2026 debris_scanner maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Whether a registered frame is believed: it must agree with its references, and doubt none of them."""

from debris_scanner.frame_fit import FrameFit
from debris_scanner.odometry_settings import OdometrySettings

# A prediction vouches little for a pose that a search found, so its frame must agree beyond doubt.
FOUND_OVERLAP = 0.78
FOUND_PART = 0.35  # of the frame is enough where a gap let the target turn out of all that is known,
FOUND_EXPLAINED = 0.88  # if it explains that part so well
FOUND_RMS = 0.0023  # m
FOUND_FREE_SPACE = 0.035
FOUND_OUTSIDE = 0.06
UNVOUCHED_CONTRADICTING = 0.008  # where not even the prediction says that the target may be there


def believable(fit: FrameFit, settings: OdometrySettings) -> bool:
    """A frame near its prediction agrees well enough."""
    a = fit.agreement
    return (
        fit.missing < settings.max_missing
        and fit.overlap > settings.min_overlap
        and a.rms < settings.max_rms
        and a.free_space < settings.max_free_space
        and a.outside < settings.max_outside
    )


def shows_more(fit: FrameFit, settings: OdometrySettings) -> bool:
    """A frame agrees with all that its references show, and shows more: something may have hidden a part."""
    a = fit.agreement
    return (
        a.outside > settings.max_outside
        and fit.missing < settings.max_keyframe_missing
        and a.rms < FOUND_RMS
        and a.free_space < FOUND_FREE_SPACE
    )


def beyond_doubt(fit: FrameFit, settings: OdometrySettings, vouched: bool = True) -> bool:
    """A frame found by search agrees so well that it is believed; ``vouched`` by where it was expected."""
    a = fit.agreement
    return (
        fit.missing < settings.max_found_missing
        and (fit.overlap > FOUND_OVERLAP or (fit.overlap > FOUND_PART and fit.explained > FOUND_EXPLAINED))
        and a.rms < FOUND_RMS
        and a.free_space < FOUND_FREE_SPACE
        and (vouched or a.contradicting < UNVOUCHED_CONTRADICTING)
        and a.outside < FOUND_OUTSIDE
    )
