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

"""The RViz and Foxglove layouts show topics and fields that the nodes publish."""

import importlib
import json
from operator import attrgetter
from pathlib import Path

import pytest
import yaml

from debris_scanner.nodes.lifecycle.stage import DEFAULT_SENSOR_FRAME
from debris_scanner.nodes.publishing.frame_names import FrameNames

pytestmark = pytest.mark.ros
VIEWS = Path(__file__).resolve().parents[2] / 'rviz'
STAGES = ('preprocess', 'odometry', 'closure', 'graph')


@pytest.fixture
def published(nodes, peer):
    """Topics of the four nodes, each with the class of its messages."""
    for stage in STAGES:
        nodes.start(stage)
    peer.until(lambda: set(STAGES) <= set(peer.reports), 'all nodes')
    own = peer.node.get_name()

    def found():
        return {
            topic: types[0]
            for topic, types in peer.node.get_topic_names_and_types()
            if any(p.node_name != own for p in peer.node.get_publishers_info_by_topic(topic))
        }

    peer.until(lambda: {'/target_points', '/odometry', '/closures', '/model'} <= set(found()), 'the topics')
    return {topic: message_class(name) for topic, name in found().items()}


def message_class(name):
    """The class of ``package/msg/Name``."""
    package, kind, message = name.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), message)


def paths_of(node):
    """All topics, and fields of topics, that a Foxglove layout names."""
    if isinstance(node, dict):
        yield from (key for key in node.get('topics', {}))
        for key, value in node.items():
            if key in ('value', 'topicPath', 'topicToRender') and isinstance(value, str):
                yield value
            yield from paths_of(value)
    elif isinstance(node, list):
        for part in node:
            yield from paths_of(part)


def panels_of(layout):
    if isinstance(layout, str):
        yield layout
    else:
        assert layout['direction'] in ('row', 'column')
        yield from panels_of(layout['first'])
        yield from panels_of(layout['second'])


def test_both_show_topics_that_are_published(published):
    foxglove = json.loads((VIEWS / 'foxglove_layout.json').read_text())
    paths = list(paths_of(foxglove['configById']))
    assert {p.split('.')[0] for p in paths} >= {'/target_points', '/model', '/model_mesh', '/graph_markers'}
    for path in paths:
        topic, _, field = path.partition('.')
        assert topic in published, f'foxglove_layout.json shows {topic}, which nobody publishes'
        if field:
            attrgetter(field)(published[topic]())

    rviz = yaml.safe_load((VIEWS / 'scan.rviz').read_text())['Visualization Manager']
    for display in rviz['Displays']:
        if 'Topic' not in display:
            continue
        topic, kind = display['Topic']['Value'], display['Class'].rpartition('/')[2]
        assert topic in published, f'scan.rviz shows {topic}, which nobody publishes'
        assert published[topic].__name__ == kind


def test_every_panel_is_laid_out_and_looks_from_the_sensor():
    foxglove = json.loads((VIEWS / 'foxglove_layout.json').read_text())
    assert sorted(panels_of(foxglove['layout'])) == sorted(foxglove['configById'])
    assert foxglove['configById']['3D!scan']['followTf'] == DEFAULT_SENSOR_FRAME
    rviz = yaml.safe_load((VIEWS / 'scan.rviz').read_text())['Visualization Manager']
    assert rviz['Global Options']['Fixed Frame'] == FrameNames().sensor  # by TF, whatever the driver calls it
