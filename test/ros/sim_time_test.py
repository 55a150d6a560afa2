#!/usr/bin/python3
"""A node in real time that follows /clock, which the test holds in its hands. The tests are in the order of names."""
import sys
import time
import unittest

import rospy
import rostest
from rosgraph_msgs.msg import Clock

from body_client import Body

TIP = (0.2, 0.2, 1.0)


class SimTimeTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.body = Body('/body')
        cls.clock = cls.body.publisher('/clock', Clock)
        cls.now = 100.0

    def advance(self, seconds):
        type(self).now += seconds
        self.clock.publish(rospy.Time.from_sec(self.now))

    def run_clock(self, seconds):
        """In small increments, each after the node has followed the last one. Returns the state of the end."""
        for _ in range(round(seconds / 0.02)):
            self.advance(0.02)
            self.body.state.clear()
            state = self.body.state.wait('state of now', lambda s: abs(self.now - s.header.stamp.to_sec()) < 0.021)
        return state

    def test_1_stands_still_while_time_does(self):
        self.body.state.wait('5 messages', lambda s: len(self.body.state.messages) >= 5)
        self.assertEqual({s.step for s in self.body.state.messages}, {0})

    def test_2_follows_the_clock(self):
        while self.body.state.messages[-1].step == 0:  # until the node has seen it tick
            self.advance(0.02)
            time.sleep(0.02)
        begin = self.run_clock(0.2).time
        self.assertAlmostEqual(self.run_clock(1.0).time - begin, 1.0, delta=0.03)

    def test_3_wrenches_expire_by_the_clock(self):
        self.body.pull(TIP, force=(1, 0, 0))
        self.body.wait_acting(1)
        self.run_clock(0.4)
        self.body.wait_acting(1)
        self.run_clock(0.2)
        self.body.wait_acting(0)

    def test_4_drops_what_it_cannot_make_up_for(self):
        before = self.run_clock(0.1)
        self.advance(1000)
        after = self.run_clock(0.1)
        self.assertLess(after.time - before.time, 0.4)
        self.assertLess(after.step - before.step, 20)
        self.advance(2)  # diagnostics follow the clock, too
        self.body.diagnosis('simulation', 'dropped time', lambda v: float(v['dropped time [s]']) > 999)

    def test_5_goes_on_when_the_clock_jumps_back(self):
        self.body.pull(TIP, force=(1, 0, 0))
        self.body.wait_acting(1)
        begin = self.run_clock(0.1).time
        self.advance(-500)
        self.body.wait_acting(0)
        self.assertGreater(self.run_clock(0.5).time, begin + 0.4)


if __name__ == '__main__':
    rospy.init_node('sim_time_test')
    rostest.rosrun('bezier_fem', 'sim_time', SimTimeTest, sys.argv)
