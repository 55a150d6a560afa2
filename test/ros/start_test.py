#!/usr/bin/python3
"""How the node starts: the scene as parameters, and what it says when they are wrong."""
import os
import signal
import subprocess
import sys
import unittest

import roslib.packages
import rospkg
import rospy
import rostest
import yaml
from bezier_fem.msg import BodyState
from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import Trigger

from body_client import PATIENCE, Inbox


class StartTest(unittest.TestCase):
    def setUp(self):
        package = rospkg.RosPack().get_path('bezier_fem')
        self.config = os.path.join(package, 'config')
        with open(os.path.join(package, 'test/data/node_scene.yaml')) as file:
            self.scene = yaml.safe_load(file)
        self.program = roslib.packages.find_node('bezier_fem', 'deformable_node')[0]

    def start(self, scene):
        if rospy.has_param('/started'):
            rospy.delete_param('/started')
        if scene:
            rospy.set_param('/started', scene)
        return subprocess.Popen([self.program, '__name:=started'], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                universal_newlines=True)

    def assertRefused(self, scene, *words):
        node = self.start(scene)
        try:
            out, err = node.communicate(timeout=PATIENCE)
        finally:
            node.kill()
        self.assertEqual(node.returncode, 2)
        lines = [line for line in (out + err).splitlines() if line]
        self.assertEqual(len(lines), 1, lines)
        for word in ('FATAL', '/started') + words:
            self.assertIn(word, lines[0])

    def assertRuns(self, scene):
        node = self.start(scene)
        try:
            rospy.wait_for_service('/started/reset', PATIENCE)
            self.assertTrue(rospy.ServiceProxy('/started/reset', Trigger)().success)
        finally:
            node.send_signal(signal.SIGINT)
            node.communicate(timeout=PATIENCE)
        self.assertEqual(node.returncode, 0)

    def test_no_scene(self):
        self.assertRefused(None, 'model')

    def test_unknown_key(self):
        self.assertRefused(dict(self.scene, materials=1), 'materials')

    def test_wrong_values(self):
        self.assertRefused(dict(self.scene, time_step='soon'), 'time_step', 'soon')
        self.assertRefused(dict(self.scene, time_step=-1.0), 'time_step', '-1')
        self.assertRefused(dict(self.scene, gravity=[0.0, 0.0, float('nan')]), 'gravity')
        self.assertRefused(dict(self.scene, material={'young': 1e5, 'poisson': 0.3, 'density': float('inf')}),
                           'material.density')
        self.assertRefused(dict(self.scene, threads=0), 'threads')
        self.assertRefused(dict(self.scene, threads='many'), 'threads', 'many')
        self.assertRefused(dict(self.scene, integrator='static'), 'integrator')

    def test_missing_file(self):
        self.assertRefused(dict(self.scene, model={'file': 'no_such.msh'}, scene_directory=self.config),
                           'model.file', 'no_such.msh')

    def test_paths_are_relative_to_scene_directory(self):
        self.assertRuns(dict(self.scene, model={'file': 'bar.msh'}, scene_directory=self.config))

    def test_ros_own_parameters_are_no_keys(self):
        self.assertRuns(dict(self.scene, live={'young': 1.0}, diagnostic_period=0.5, threads=2))

    def test_free_run_waits_for_no_clock(self):
        scene = dict(self.scene, node={'mode': 'free_run', 'publish_rate': 50})
        node = self.start(scene)
        try:
            state = Inbox('/started/state', BodyState)
            self.assertGreater(state.wait('fast step', lambda s: s.real_time_factor > 2).step, 0)
        finally:
            node.send_signal(signal.SIGINT)
            node.communicate(timeout=PATIENCE)

    def test_computes_nothing_for_topics_that_nobody_hears(self):
        def computed(message):
            return [int(v.value) for s in message.status if s.name == 'started: simulation'
                    for v in s.values if v.key == 'messages computed']
        node = self.start(self.scene)
        try:
            diagnostics = Inbox('/diagnostics', DiagnosticArray)
            diagnostics.wait('3 periods', lambda m: sum(len(computed(n)) for n in diagnostics.messages) >= 3)
            self.assertEqual({count for m in diagnostics.messages for count in computed(m)}, {0})
            state = Inbox('/started/state', BodyState)
            state.wait('state')
            diagnostics.wait('computed messages', lambda m: sum(computed(m)) > 0)
        finally:
            node.send_signal(signal.SIGINT)
            node.communicate(timeout=PATIENCE)

    def test_numbers_that_yaml_1_1_takes_for_text(self):
        self.assertRuns(dict(self.scene, material={'young': '2.0e5', 'poisson': '3e-1', 'density': 500}))


if __name__ == '__main__':
    rospy.init_node('start_test')
    rostest.rosrun('bezier_fem', 'start', StartTest, sys.argv)
