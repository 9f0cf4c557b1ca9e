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

import pytest

from msg_adapters.errors import BagError, MalformedMessage


@pytest.mark.parametrize('error', [BagError, MalformedMessage])
def test_names_from_a_damaged_message_cannot_break_the_line(error):
    assert str(error("no field 'a\nb\x1b[31m' in /größe")) == "no field 'a b [31m' in /größe"
    assert isinstance(error('x'), ValueError)


@pytest.mark.parametrize('error', [BagError, MalformedMessage])
def test_a_name_without_end_does_not_fill_the_log(error):
    assert len(str(error(f'encoding {"9" * 10**6}'))) < 2100
