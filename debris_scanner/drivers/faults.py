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

"""Faults of a device, each with advice."""

from enum import StrEnum


class Fault(StrEnum):
    """Kind of a fault, as the diagnostics name it."""

    LIBRARY = 'no library'
    DEVICE = 'no device'
    PERMISSION = 'no permission'
    LOST = 'device lost'
    RECORDING = 'bad recording'
    INTRINSICS = 'no intrinsics'
    MODE = 'no such mode'
    SILENT = 'no frames'
    CRASHED = 'driver library crashed'


class DriverError(Exception):
    """A device cannot be used now; trying again later may help.

    Args:
        fault: its kind.
        text: what happened, naming the thing.
        advice: what to do about it.
    """

    def __init__(self, fault: Fault, text: str, advice: str = '') -> None:
        super().__init__(fault, text, advice)
        self.fault = fault
        self.text = text
        self.advice = advice

    def __str__(self) -> str:
        return f'{self.fault}: {self.text}' + (f'; {self.advice}' if self.advice else '')


class EndOfRecording(Exception):
    """A recording has been played to its end."""
