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

"""From what the user names to recordings: bags, folders, globs, URLs; each once, under a name of its own."""

import pytest

from debris_scanner.batch import BatchError
from debris_scanner.batch.inputs import find_recordings


@pytest.fixture
def lab(tmp_path):
    """Bags as labs keep them: some in folders of their own, some as single files, other things between."""
    for name in (
        'one/metadata.yaml',
        'one/one_0.mcap',
        'one/truth.tum',
        'day/two/metadata.yaml',
        'day/two/b.db3',
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    for name in ('day/three.mcap', 'day/old.bag', 'day/cut.bag.active', 'notes.txt', '.hidden/x.mcap'):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    return tmp_path


def names(*inputs):
    return [r.name for r in find_recordings([str(i) for i in inputs])]


def test_a_folder_gives_all_bags_below_it(lab):
    found = {r.name: r for r in find_recordings([str(lab)])}
    assert sorted(found) == ['day_cut', 'day_old', 'day_three', 'day_two', 'one']
    assert [name for name, _ in found['one'].files] == ['metadata.yaml', 'one_0.mcap']
    assert found['one'].folder and not found['day_three'].folder
    assert found['day_old'].files[0][1] == f'file://{lab}/day/old.bag'


def test_links_are_followed_once(lab, tmp_path_factory):
    chosen = tmp_path_factory.mktemp('chosen')
    (chosen / 'all').symlink_to(lab)
    (chosen / 'round').symlink_to(chosen)
    assert names(chosen) == [f'all_{name}' for name in names(lab)]


def test_a_bag_a_file_and_a_glob(lab):
    assert names(lab / 'one') == ['one']
    assert names(lab / 'day' / 'three.mcap') == ['three']
    assert names(lab / 'day' / '*.mcap', f'file://{lab}/one') == ['three', 'one']
    assert names(lab / 'notes.txt') == ['notes.txt']  # what is named outright is tried


def test_each_once_and_names_differ(lab):
    assert names(lab / 'one', lab / 'one', lab / 'on*') == ['one']
    (lab / 'other' / 'one').mkdir(parents=True)
    (lab / 'other' / 'one' / 'metadata.yaml').write_text('')
    (lab / 'other' / 'one' / 'x.mcap').write_text('')
    both = names(lab / 'one', lab / 'other' / 'one')
    assert len(set(both)) == 2 and all(n.startswith('one-') for n in both)
    assert names(lab / 'other' / 'one', lab / 'one') == both


def test_the_fingerprint_follows_the_files(lab):
    (before,) = find_recordings([str(lab / 'one')])
    (again,) = find_recordings([str(lab / 'one')])
    (lab / 'one' / 'one_0.mcap').write_text('changed')
    (after,) = find_recordings([str(lab / 'one')])
    assert before.fingerprint == again.fingerprint != after.fingerprint


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        ('nowhere', 'does not exist'),
        ('empty', 'no recording in'),
        ('*.pcap', 'nothing matches'),
        ('memory://bags', 'one process alone'),
        ('teapot://bags', 'teapot'),
    ],
)
def test_inputs_that_lead_nowhere_are_named(tmp_path, given, said):
    (tmp_path / 'empty').mkdir()
    with pytest.raises(BatchError, match=said) as caught:
        find_recordings([given if '://' in given else str(tmp_path / given)])
    assert given in str(caught.value) and '\n' not in str(caught.value)
