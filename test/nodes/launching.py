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

"""As much of ``launch`` and ``launch_ros`` as our launch files use, to run them without a whole ROS.

The nodes are real: a launch file's actions are carried out as Jazzy's ``launch`` would, parameter files,
overrides, remappings and environment included. Arguments that Jazzy's actions do not have are a TypeError.
"""

import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import yaml

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 60.0


class LaunchContext:
    is_shutdown = False

    def __init__(self, configurations):
        self.launch_configurations = dict(configurations)
        self.environment = dict(os.environ)


class LaunchConfiguration:
    def __init__(self, variable_name):
        self.name = variable_name

    def perform(self, context):
        return context.launch_configurations[self.name]


class FindPackageShare:
    def __init__(self, package):
        assert package == 'debris_scanner'

    def perform(self, context):
        return str(ROOT)


class PathJoinSubstitution:
    def __init__(self, substitutions):
        self.parts = substitutions

    def perform(self, context):
        return str(Path(*(text(part, context) for part in self.parts)))


def text(value, context):
    """What a string, a substitution or a list of both comes to."""
    if isinstance(value, list):
        return ''.join(text(part, context) for part in value)
    return value if isinstance(value, str) else value.perform(context)


class ParameterValue:
    def __init__(self, value, *, value_type=None):
        assert not isinstance(value, str) or value_type is str, 'launch_ros wants a substitution'
        self.value, self.value_type = value, value_type

    def evaluate(self, context):
        return self.value_type(text(self.value, context))


class DeclareLaunchArgument:
    def __init__(self, name, *, default_value=None, description=None, choices=None):
        self.name, self.default, self.choices = name, default_value, choices
        assert choices is None or default_value in choices

    def execute(self, context, launched):
        if self.name not in context.launch_configurations:
            context.launch_configurations[self.name] = text(self.default, context)
        assert self.choices is None or context.launch_configurations[self.name] in self.choices


class UnlessCondition:
    def __init__(self, predicate):
        self.predicate = predicate

    def evaluate(self, context):
        return text(self.predicate, context).lower() not in ('true', '1')


class SetEnvironmentVariable:
    def __init__(self, name, value, *, condition=None):
        self.name, self.value, self.condition = name, value, condition

    def execute(self, context, launched):
        if self.condition is None or self.condition.evaluate(context):
            context.environment[self.name] = text(self.value, context)


class OpaqueFunction:
    def __init__(self, *, function):
        self.function = function

    def execute(self, context, launched):
        for action in self.function(context):
            action.execute(context, launched)


class TimerAction:
    def __init__(self, *, period, actions, cancel_on_shutdown=False):
        self.period, self.actions = period, actions


class ShutdownProcess:
    def __init__(self, *, process_matcher):
        self.process_matcher = process_matcher


class EmitEvent:
    def __init__(self, *, event):
        self.event = event


class Action:
    pass


class ProcessExited:
    def __init__(self, returncode):
        self.returncode = returncode


class PythonLaunchDescriptionSource:
    def __init__(self, location):
        self.location = location


class IncludeLaunchDescription:
    def __init__(self, source, *, launch_arguments=()):
        self.source, self.arguments = source, launch_arguments

    def execute(self, context, launched):
        for name, value in self.arguments:
            context.launch_configurations[name] = text(value, context)
        for action in description(Path(text(self.source.location, context))):
            action.execute(context, launched)


class LaunchDescription:
    def __init__(self, initial_entities=()):
        self.entities = list(initial_entities)


class Node:
    def __init__(
        self,
        *,
        executable,
        package=None,
        name=None,
        namespace=None,
        parameters=None,
        remappings=None,
        arguments=None,
        ros_arguments=(),
        output='log',
        additional_env=None,
        on_exit=None,
        sigterm_timeout='5',
        sigkill_timeout='5',
    ):
        assert isinstance(sigterm_timeout, str), 'launch takes the time as text'
        assert isinstance(sigkill_timeout, str), 'launch takes the time as text'
        assert output in ('log', 'screen', 'both')
        self.package, self.executable, self.on_exit = package, executable, on_exit
        self.namespace, self.ros_arguments = namespace, ros_arguments
        self.additional_env = additional_env or {}
        self.parameters, self.remappings = parameters or [], remappings or []

    def execute(self, context, launched):
        arguments = ['--ros-args']
        for number, given in enumerate(self.parameters):
            if isinstance(given, dict):
                file = launched.folder / f'{self.executable}-{number}.yaml'
                file.write_text(yaml.safe_dump({'/**': {'ros__parameters': _plain(given, context)}}))
                arguments += ['--params-file', str(file)]
            else:
                arguments += ['--params-file', text(given, context)]
        for old, new in self.remappings:
            arguments += ['-r', f'{old}:={text(new, context)}']
        if self.namespace:
            arguments += ['-r', f'__ns:=/{self.namespace}']
        environment = context.environment | self.additional_env
        launched.start(self, [*arguments, *self.ros_arguments], environment)


def _plain(parameters, context):
    return {k: v.evaluate(context) if isinstance(v, ParameterValue) else v for k, v in parameters.items()}


_MODULES = {
    'launch': (Action, LaunchContext, LaunchDescription),
    'launch.actions': (
        DeclareLaunchArgument,
        EmitEvent,
        IncludeLaunchDescription,
        OpaqueFunction,
        SetEnvironmentVariable,
        TimerAction,
    ),
    'launch.conditions': (UnlessCondition,),
    'launch.events': (),
    'launch.events.process': (ProcessExited, ShutdownProcess),
    'launch.launch_description_sources': (PythonLaunchDescriptionSource,),
    'launch.substitutions': (LaunchConfiguration, PathJoinSubstitution),
    'launch_ros': (),
    'launch_ros.actions': (Node,),
    'launch_ros.parameter_descriptions': (ParameterValue,),
    'launch_ros.substitutions': (FindPackageShare,),
}


def install(monkeypatch):
    """Let ``import launch`` find what is here."""
    for name, members in _MODULES.items():
        module = ModuleType(name)
        for member in members:
            setattr(module, member.__name__, member)
        monkeypatch.setitem(sys.modules, name, module)


def description(path):
    """The actions of a launch file."""
    spec = importlib.util.spec_from_file_location(path.name.replace('.', '_'), path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description().entities


class Launched:
    """The processes of a launch file; leaving the context interrupts those that still run.

    Args:
        path: launch file.
        arguments: of the launch, by name.
        folder: for logs and parameters.
    """

    def __init__(self, path, arguments, folder):
        self.path, self.arguments, self.folder = path, arguments, folder
        self.nodes, self.processes = {}, {}

    def __enter__(self):
        self.folder.mkdir(parents=True, exist_ok=True)
        context = self.context = LaunchContext(self.arguments)
        try:
            for action in description(self.path):
                action.execute(context, self)
        except BaseException:
            self.__exit__()
            raise
        return self

    def start(self, node, arguments, environment):
        script = Path(sys.prefix, 'lib', node.package, node.executable)
        assert script.is_file(), f'ros2 run would not find {script}'
        with self.log(node.executable).open('wb') as log:
            self.processes[node.executable] = subprocess.Popen(
                [str(script), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                cwd=self.folder,
                start_new_session=True,
            )
        self.nodes[node.executable] = node

    def log(self, executable):
        return self.folder / f'{executable}.log'

    def wait(self, executable, timeout_s):
        """Exit code of a process that ends by itself, and the actions that follow."""
        code = self.processes[executable].wait(timeout_s)
        return code, self._ended(executable)

    def _ended(self, executable):
        node, code = self.nodes[executable], self.processes[executable].returncode
        return (node.on_exit(ProcessExited(code), self.context) if node.on_exit else None) or []

    def __exit__(self, *_):
        for process in self.processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self.processes.values():
            try:
                process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.context.is_shutdown = True
        for executable in self.processes:
            self._ended(executable)
