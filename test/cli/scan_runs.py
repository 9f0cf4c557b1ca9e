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

"""Runs of `debris-scan scan` and what they leave, for the tests of the verb."""

import json

from debris_scanner.cli.main import main


def run(bag, out, *options):
    return main(['scan', str(bag), '--out', str(out), *options])


def summary(out):
    return json.loads((out / 'summary.json').read_text())


def simulated(folder, target, *options):
    assert main(['simulate', target, '--out', str(folder), *options]) == 0
    return folder


def one_line(capsys, *words):
    err = capsys.readouterr().err
    assert err.count('\n') == 1, err
    assert err.startswith('debris-scan scan: ')
    assert 'Traceback' not in err
    for word in words:
        assert str(word) in err
    return err
