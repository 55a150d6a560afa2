#!/usr/bin/python3
"""A region that follows a tf frame. The tests are in the order of their names: tf does not forget."""
import sys
import unittest

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import TransformStamped, Vector3
from tf2_msgs.msg import TFMessage

from body_client import Body

HALF = np.sqrt(0.5)
QUARTER_TURN = (0, 0, HALF, HALF)  # about z


class FrameTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.body = Body('/body')
        cls.tf = cls.body.publisher('/tf', TFMessage)

    def move(self, position, rotation=(0, 0, 0, 1)):
        """Moves the hand and waits until the node has seen it."""
        message = TransformStamped()
        message.header.frame_id = 'world'
        message.header.stamp = rospy.Time.now()
        message.child_frame_id = 'hand'
        message.transform.translation = Vector3(*position)
        r = message.transform.rotation
        r.x, r.y, r.z, r.w = rotation
        self.tf.publish(TFMessage([message]))

    def step_until(self, probe, position):
        """tf has no answer, so step until the region has got there, as it does in the step after it has come."""
        for _ in range(500):
            state = self.body.step(1)
            if np.linalg.norm(self.body.probe(state, probe) - position) < 1e-9:
                return state
        self.fail('%s is at %s, not at %s' % (probe, self.body.probe(state, probe), position))

    def test_1_stays_where_it_is_without_a_transform(self):
        self.body.restart()
        found = self.body.diagnosis('frames', 'warning', lambda v: v['level'] == 1)
        self.assertIn('hand', found['message'])
        self.assertIn('wall', found['message'])
        self.assertLess(np.linalg.norm(self.body.probe(self.body.step(10), 'corner')), 1e-12)

    def test_2_keeps_its_offset_from_the_first_transform(self):
        self.move((5, 0, 0))
        self.body.diagnosis('frames', 'ok', lambda v: v['level'] == 0)
        self.assertLess(np.linalg.norm(self.body.probe(self.body.step(10), 'corner')), 1e-12)
        self.move((5.01, 0.02, -0.01))
        state = self.step_until('corner', (0.01, 0.02, -0.01))
        self.assertGreater(np.linalg.norm(self.body.probe(state, 'tip') - (0.21, 0.22, 0.99)), 1e-4)  # lags behind
        state = self.body.step(300)
        self.assertLess(np.linalg.norm(self.body.probe(state, 'tip') - (0.21, 0.22, 0.99)), 1e-4)  # and comes after

    def test_3_turns_about_the_frame(self):
        """About the hand, which started 5 m beside the corner."""
        self.body.restart()  # the offset of now is kept from here on
        for angle in np.linspace(0, np.pi / 2, 30)[1:]:
            q = (0, 0, np.sin(angle / 2), np.cos(angle / 2))
            corner = np.array((5.01, 0.02, -0.01)) + 5.01 * np.array((-np.cos(angle), -np.sin(angle), 0))
            corner += 0.02 * np.array((np.sin(angle), -np.cos(angle), 0)) + (0, 0, 0.01)
            self.move((5.01, 0.02, -0.01), q)
            self.step_until('corner', corner)

    def test_4_a_jump_out_of_this_world_is_told_and_forgiven(self):
        self.body.restart()
        for x in (1.7e308, -1.7e308, 1.7e308):
            self.move((x, 0, 0))
            self.body.services['step'](100)
        self.move((0, 0, 0))
        answer = self.body.services['step'](1)
        if not answer.success:
            self.assertIn('reset', answer.message)
            self.assertFalse(self.body.pause(False).success)
            found = self.body.diagnosis('simulation', 'error', lambda v: v['level'] == 2)
            self.assertIn('reset', found['message'])
        self.body.restart()
        self.assertLess(np.linalg.norm(self.body.probe(self.body.step(10), 'corner')), 1e-12)


if __name__ == '__main__':
    rospy.init_node('frame_test')
    rostest.rosrun('bezier_fem', 'frame', FrameTest, sys.argv)
