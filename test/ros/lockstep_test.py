#!/usr/bin/python3
"""A node that steps on the stamps of its inputs."""
import sys
import unittest

import numpy as np
import rospy
import rostest

from body_client import Body

TIP = (0.2, 0.2, 1.0)
START = 1000.0  # s


class LockstepTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.body = Body('/body')

    def setUp(self):
        self.body.restart()
        self.body.pause(False)

    def pull(self, after, force, name='a'):
        self.body.pull(TIP, force=(force, 0, 0), stamp=rospy.Time.from_sec(START + after), name=name)

    def state(self, step):
        return self.body.state.wait('state of step %d' % step, lambda s: s.step == step)

    def test_steps_as_far_as_its_inputs_reach(self):
        self.pull(0, 1)
        self.pull(0.2, 1)
        state = self.state(10)
        self.assertAlmostEqual(state.header.stamp.to_sec(), START + 0.2, places=6)
        self.pull(0.259, 1)  # lies in the step that begins at 0.24
        state = self.state(12)
        self.assertAlmostEqual(state.time, 0.24)
        # And no further, however long one waits
        self.body.state.clear()
        self.body.state.wait('5 messages', lambda s: len(self.body.state.messages) >= 5)
        self.assertEqual({s.step for s in self.body.state.messages}, {12})

    def test_inputs_act_from_their_stamps(self):
        self.pull(0, 0)
        self.pull(0.2, 5)
        rest = self.state(10)
        self.assertLess(max(rest.von_mises), 1e-6)
        self.pull(0.22, 5)
        self.assertGreater(self.body.probe(self.state(11), 'tip')[0], TIP[0] + 1e-6)

    def test_the_same_inputs_give_the_same_motion(self):
        motions = []
        for hurried in (True, False):
            self.body.restart()
            self.body.pause(False)
            rng = np.random.default_rng(3)
            for k in range(40):
                self.pull(0.013 * k, rng.uniform(-5, 5), 'ab'[k % 2])
                if not hurried:
                    self.state(int(0.013 * k / 0.02 + 1e-9))
            motions.append(self.state(25).points)
        self.assertEqual(*motions)

    def test_expires_by_stamp(self):
        self.pull(0, 2)
        self.pull(0.48, 0, 'b')
        self.state(24)
        self.body.wait_acting(1)
        self.pull(0.62, 0, 'b')  # at 0.5 the first one is as old as timeout
        self.state(31)
        self.body.wait_acting(0)

    def test_drops_what_is_older_than_timeout(self):
        key = 'dropped: too old or out of range'
        before = int(self.body.diagnosis('inputs', key, lambda v: key in v)[key])
        self.pull(0, 0)
        self.pull(1, 0)
        self.state(50)
        self.pull(0.4, 7, 'late')
        self.body.diagnosis('inputs', key, lambda v: int(v[key]) == before + 1)
        self.pull(0.6, 7, 'less late')
        self.body.wait_acting(1)

    def test_skips_a_gap_that_no_steps_can_fill(self):
        self.pull(0, 0)
        self.pull(3e9, 0)
        self.pull(3e9 + 0.1, 0)
        state = self.body.state.wait('state after the gap', lambda s: s.header.stamp.to_sec() > START + 3e9 + 0.09)
        self.assertLess(state.step, 10)
        self.body.diagnosis('simulation', 'dropped time', lambda v: float(v['dropped time [s]']) > 2e9)

    def test_steps_by_service_too(self):
        state = self.body.step(7)
        self.assertEqual(state.step, 7)


if __name__ == '__main__':
    rospy.init_node('lockstep_test')
    rostest.rosrun('bezier_fem', 'lockstep', LockstepTest, sys.argv)
