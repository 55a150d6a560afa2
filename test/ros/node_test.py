#!/usr/bin/python3
"""A node in real time that the tests pause and step, driven as other nodes would drive it."""
import math
import os
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import roslib.packages
import rospkg
import rospy
import rostest
import yaml
from bezier_fem.msg import Contact, ContactArray, SurfaceTopology
from dynamic_reconfigure.client import Client
from geometry_msgs.msg import Point, TransformStamped, Vector3, WrenchStamped
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from body_client import PATIENCE, Body, Inbox, xyz

TIP = (0.2, 0.2, 1.0)
SETTLED = 300  # steps

ANOTHER_NODE = '''
import rospy
from bezier_fem.msg import PointWrench
from geometry_msgs.msg import Point, Vector3
rospy.init_node('another')
message = PointWrench(id='b', point=Point(0.2, 0.2, 1.0))
message.header.frame_id = 'world'
message.wrench.force = Vector3(1.5, 0, 0)
rospy.Publisher('/body/point_wrench', PointWrench, queue_size=1, latch=True).publish(message)
rospy.spin()
'''


def transform(child, stamp, xyz_, yaw=0.0, quaternion=None):
    message = TransformStamped()
    message.header.frame_id = 'world'
    message.header.stamp = stamp
    message.child_frame_id = child
    message.transform.translation = Vector3(*xyz_)
    q = quaternion or (0, 0, math.sin(yaw / 2), math.cos(yaw / 2))
    r = message.transform.rotation
    r.x, r.y, r.z, r.w = q
    return message


class NodeTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.body = Body('/body')
        cls.wrench = cls.body.publisher('wrench', WrenchStamped)
        cls.contacts = cls.body.publisher('contacts', ContactArray)
        cls.tf = cls.body.publisher('/tf', TFMessage)
        cls.static_tf = cls.body.publisher('/tf_static', TFMessage, latch=True)
        cls.live = Client('/body/live', timeout=PATIENCE)
        cls.initial = cls.live.get_configuration()

    def setUp(self):
        self.live.update_configuration({k: v for k, v in self.initial.items() if k != 'groups'})
        self.body.restart()

    def static_answer(self, force):
        """Probes at the equilibrium that run_scene finds for a force spread over the bar's free end."""
        package = rospkg.RosPack().get_path('bezier_fem')
        with open(os.path.join(package, 'test/data/node_scene.yaml')) as file:
            scene = yaml.safe_load(file)
        scene['loads'] = [{'box': {'min': [-1.0, -1.0, 0.99], 'max': [1.0, 1.0, 1.01]}, 'force': list(force)}]
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'scene.yaml')
            with open(path, 'w') as file:
                yaml.safe_dump(scene, file)
            csv = os.path.join(folder, 'probes.csv')
            subprocess.run([roslib.packages.find_node('bezier_fem', 'run_scene')[0], path, '--static', '--probes', csv],
                           check=True, timeout=PATIENCE)
            table = np.genfromtxt(csv, delimiter=',', names=True)
        return {name: np.array([table[-1][name + axis] for axis in ('x', 'y', 'z')]) for name in ('middle', 'tip')}

    def assertClose(self, found, expected, tolerance):
        self.assertLess(np.linalg.norm(np.asarray(found) - np.asarray(expected)), tolerance,
                        '%s is not %s' % (found, expected))

    # Pause, step, reset

    def test_steps_when_paused(self):
        state = self.body.step(5)
        self.assertEqual(state.step, 5)
        self.assertAlmostEqual(state.time, 0.1)
        self.assertEqual(self.body.step(1).step, 6)
        answer = self.body.services['step'](0)
        self.assertTrue(answer.success)
        self.assertAlmostEqual(answer.time, 0.12)

    def test_refuses_to_step_when_running(self):
        self.assertTrue(self.body.pause(False).success)
        answer = self.body.services['step'](1)
        self.assertFalse(answer.success)
        self.assertIn('set_paused', answer.message)

    def test_refuses_steps_without_end(self):
        answer = self.body.services['step'](4000000000)
        self.assertFalse(answer.success)
        self.assertIn('100000', answer.message)

    def test_keeps_up_with_time(self):
        self.body.pause(False)
        first = self.body.state.wait('step', lambda s: s.step > 0)
        last = self.body.state.wait('state 1 s later', lambda s: s.time > first.time + 1)
        elapsed = (last.header.stamp - first.header.stamp).to_sec()
        self.assertLess(last.time - first.time, elapsed + 0.03)
        self.assertGreater(last.time - first.time, 0.6 * elapsed)  # a busy machine may make it drop some

    def test_stands_still_when_paused(self):
        self.body.pause(False)
        self.body.state.wait('step', lambda s: s.step > 0)
        self.body.pause(True)
        self.body.state.clear()
        begin = self.body.state.wait('state').step
        self.body.state.clear()
        self.body.state.wait('5 messages', lambda s: len(self.body.state.messages) >= 5)
        self.assertEqual({s.step for s in self.body.state.messages}, {begin})

    def test_reset_goes_back_to_the_start(self):
        rest = self.body.state.wait('state', lambda s: s.step == 0)
        self.body.pull(TIP, force=(5, 0, 0))
        self.body.wait_acting(1)
        moved = self.body.step(20)
        self.assertGreater(np.linalg.norm(np.subtract(moved.points, rest.points)), 0.01)
        self.body.restart()
        again = self.body.state.wait('state', lambda s: s.step == 0)
        self.assertEqual(again.points, rest.points)
        self.assertEqual(again.time, 0)
        self.assertEqual(self.body.step(5).points, rest.points)  # nothing acts any more

    # Wrenches

    def test_force_gives_the_static_answer(self):
        force = (2, 0, 0)
        expected = self.static_answer(force)
        self.body.pull(TIP, force=force)
        arrow, = self.body.wait_acting(1)
        state = self.body.step(SETTLED)
        for name in ('middle', 'tip'):
            rest = np.array(TIP) * (1, 1, 0.5 if name == 'middle' else 1)
            found, answer = self.body.probe(state, name) - rest, expected[name] - rest
            self.assertGreater(answer[0], 0)
            self.assertClose(found, answer, 0.01 * np.linalg.norm(answer))
        self.assertLess(state.kinetic_energy, 1e-6 * state.elastic_energy)
        self.assertClose(xyz(arrow.points[1]) - xyz(arrow.points[0]),
                         [np.linalg.norm(xyz(arrow.points[1]) - xyz(arrow.points[0])), 0, 0], 1e-6)
        held, torque = self.body.wall()
        self.assertClose(held, -np.array(force), 0.001 * 2)
        self.assertClose(torque, -np.cross(self.body.probe(state, 'tip'), force), 0.01 * 2)

    def test_a_body_at_rest_sleeps_until_it_is_pulled(self):
        self.body.pull(TIP, force=(2, 0, 0))
        self.body.wait_acting(1)
        rest = self.body.step(SETTLED)
        self.assertEqual((rest.substeps, rest.iterations, rest.kinetic_energy), (0, 0, 0))
        held, _ = self.body.wall()
        later = self.body.step(10)
        self.assertEqual(later.points, rest.points)
        self.assertAlmostEqual(later.time, rest.time + 0.2)
        self.assertClose(self.body.wall()[0], held, 1e-12)
        self.body.pull(TIP, force=(0, 3, 0), name='other')
        self.body.wait_acting(2)
        pulled = self.body.step(5)
        self.assertGreater(pulled.iterations, 0)
        self.assertGreater(self.body.probe(pulled, 'tip')[1], self.body.probe(rest, 'tip')[1] + 1e-4)

    def test_torque_is_taken_up_by_the_support(self):
        torque = np.array([0.1, -0.2, 0.3])
        self.body.pull(TIP, torque=torque)
        # Nothing but a torque has no straight arrow to wait for
        self.body.forces.wait('torque', lambda m: any(k.ns == 'torques' for k in m.markers))
        self.body.step(SETTLED)
        force, held = self.body.wall()
        self.assertClose(force, [0, 0, 0], 1e-3)
        self.assertClose(held, -torque, 0.002 * np.linalg.norm(torque))

    def test_messages_add_up_and_replace_their_like(self):
        self.body.pull(TIP, force=(1, 0, 0), name='a')
        self.body.pull(TIP, force=(0, 0, 9), name='b')
        message = WrenchStamped()
        message.header.frame_id = 'tip'
        message.wrench.force.y = 4
        self.static_tf.publish(TFMessage([transform('tip', rospy.Time.now(), TIP)]))
        self.wrench.publish(message)
        self.body.wait_acting(3)
        self.body.pull(TIP, force=(0, 0, 3), name='b')
        other = subprocess.Popen([sys.executable, '-c', ANOTHER_NODE])
        try:
            self.body.wait_acting(4)
        finally:
            other.terminate()
            other.wait()
        self.body.step(SETTLED)
        self.assertClose(self.body.wall()[0], [-2.5, -4, -3], 0.01)

    def test_wrench_acts_at_its_frame_when_it_was_stamped(self):
        """The frame turns by 90 degrees in a second: half a second ago it had turned by 45."""
        now = rospy.Time.now()
        second = rospy.Duration(1)
        self.tf.publish(TFMessage([transform('hand', now - second, TIP, 0),
                                   transform('hand', now, TIP, math.pi / 2)]))
        message = WrenchStamped()
        message.header.frame_id = 'hand'
        message.header.stamp = now - second / 2
        message.wrench.force.x = 2
        self.wrench.publish(message)
        self.body.wait_acting(1)
        self.body.step(SETTLED)
        self.assertClose(self.body.wall()[0], [-math.sqrt(2), -math.sqrt(2), 0], 0.005)

        message.header.stamp = rospy.Time()  # the latest
        self.wrench.publish(message)
        self.body.forces.wait('turned arrow', lambda m: any(
            k.ns == 'wrenches' and abs(k.points[1].x - k.points[0].x) < 1e-6 for k in m.markers))
        self.body.step(SETTLED)
        self.assertClose(self.body.wall()[0], [0, -2, 0], 0.005)

    def test_force_stays_with_the_material(self):
        self.body.pull(TIP, force=(400, 0, 0))
        self.body.wait_acting(1)
        state = self.body.step(SETTLED)
        arrow, = self.body.wait_acting(1)
        self.assertGreater(self.body.probe(state, 'tip')[0], 0.4)
        self.assertClose(xyz(arrow.points[0]), self.body.probe(state, 'tip'), 0.1)

    # Contacts

    def test_contacts_are_replaced_and_cleared_as_a_whole(self):
        def contact(point, force):
            return Contact(Point(*point), Vector3(-1, 0, 0), Vector3(*force))
        message = ContactArray()
        message.header.frame_id = 'world'
        message.contacts = [contact((0.4, 0.2, 0.8), (-1, 0, 0)), contact((0.4, 0.2, 0.6), (-2, 0, 0)),
                            contact((0.2, 0.4, 0.9), (0, -3, 0))]
        self.contacts.publish(message)
        self.body.wait_acting(3, 'contacts')
        self.body.step(SETTLED)
        force, torque = self.body.wall()
        self.assertClose(force, [3, 3, 0], 0.01)
        message.contacts = message.contacts[:1]
        self.contacts.publish(message)
        self.body.wait_acting(1, 'contacts')
        self.body.step(SETTLED)
        self.assertClose(self.body.wall()[0], [1, 0, 0], 0.01)
        message.contacts = []
        self.contacts.publish(message)
        self.body.wait_acting(0, 'contacts')
        self.body.step(SETTLED)
        self.assertClose(self.body.wall()[0], [0, 0, 0], 0.01)

    # What is refused

    def test_says_what_it_drops_and_goes_on(self):
        before = self.body.diagnosis('inputs', 'values', lambda v: 'last dropped' in v)

        def refused(reason, text):
            key = 'dropped: ' + reason
            found = self.body.diagnosis('inputs', key, lambda v: int(v[key]) == int(before[key]) + 1)
            self.assertIn(text, found['last dropped'])

        self.body.pull(TIP, force=(float('nan'), 0, 0))
        refused('not finite', 'finite')
        self.body.pull((float('inf'), 0, 0), force=(1, 0, 0))
        before['dropped: not finite'] = int(before['dropped: not finite']) + 1
        refused('not finite', 'finite')
        self.body.pull(TIP, force=(1, 0, 0), frame='nowhere')
        refused('no transform', 'nowhere')
        before['dropped: no transform'] = int(before['dropped: no transform']) + 1
        self.body.pull(TIP, force=(1, 0, 0), frame='')
        refused('no transform', "''")
        before['dropped: no transform'] = int(before['dropped: no transform']) + 1
        self.tf.publish(TFMessage([transform('broken', rospy.Time.now(), TIP, quaternion=(0, 0, 0, 0))]))
        self.body.pull((0, 0, 0), force=(1, 0, 0), frame='broken')
        refused('no transform', 'broken')
        self.body.pull((0.2, 0.2, 1.11), force=(1, 0, 0))
        refused('too far from the surface', 'max_distance')

        self.body.pull((0.2, 0.2, 1.09), force=(1, 0, 0))
        self.body.wait_acting(1)
        self.body.step(SETTLED)
        self.assertClose(self.body.wall()[0], [-1, 0, 0], 0.01)

    def test_survives_forces_beyond_all_numbers(self):
        rest = self.body.step(1)
        for force in (1e40, 1e150, 1e300, 1.7e308):
            self.body.pull(TIP, force=(force, -force, force))
            self.body.wait_acting(1)
            self.body.services['step'](50)
            self.body.restart()
        self.assertEqual(self.body.step(1).points, rest.points)
        self.test_force_gives_the_static_answer()

    # Outputs

    def test_topology_comes_to_latecomers_and_fits_the_state(self):
        topology = Inbox('/body/topology', SurfaceTopology).wait('topology')
        state = self.body.state.wait('state')
        triangles = np.reshape(topology.triangles, (-1, 3))
        points = np.reshape(state.points, (-1, 3))
        self.assertEqual(topology.points, len(points))
        self.assertEqual(set(triangles.ravel()), set(range(len(points))))
        self.assertEqual(len(state.von_mises), len(points))
        corners = points[triangles]
        areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        volume = np.einsum('ij,ij->', areas, corners.mean(axis=1)) / 3
        self.assertAlmostEqual(volume, 0.16, places=5)  # closed and turned outwards
        normals = np.reshape(state.normals, (-1, 3))
        self.assertTrue(np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5))
        self.assertTrue(np.all(np.einsum('ijk,ik->ij', normals[triangles], areas) > 0))

    def test_stress_is_coloured_and_has_a_legend(self):
        stress = Inbox('/body/stress', MarkerArray)
        surface = Inbox('/body/surface', Marker)
        self.body.pull(TIP, force=(10, 0, 0))
        self.body.wait_acting(1)
        state = self.body.step(SETTLED)
        # Not one of before, that has been on its way
        markers = stress.wait('markers', lambda m: m.markers[0].header.stamp >= state.header.stamp).markers
        body, = [m for m in markers if m.ns == 'stress']
        self.assertEqual(len(body.colors), len(body.points))
        self.assertEqual(len(body.points) % 3, 0)
        self.assertTrue(all(0 <= c.r <= 1 and 0 <= c.g <= 1 and 0 <= c.b <= 1 and c.a == 1 for c in body.colors))
        self.assertGreater(len({(c.r, c.g, c.b) for c in body.colors}), 20)
        words = [m.text for m in markers if m.type == Marker.TEXT_VIEW_FACING and m.action == Marker.ADD]
        self.assertTrue(any('Pa' in text for text in words), words)
        self.assertGreaterEqual(len(words), 4)
        bending = 10 * 1.0 * 0.2 / (0.4 ** 4 / 12)  # Pa, M c / I at the wall
        self.assertGreater(max(state.von_mises), 0.7 * bending)
        self.assertLess(max(state.von_mises), 2 * bending)
        plain = surface.wait('marker', lambda m: m.header.stamp >= state.header.stamp)
        self.assertEqual(plain.type, Marker.TRIANGLE_LIST)
        self.assertTrue(np.allclose([xyz(p) for p in plain.points], [xyz(p) for p in body.points]))

    # Live settings

    def test_live_settings_begin_with_the_scene(self):
        for key, value in {'young': 2e5, 'poisson': 0.34, 'density': 500, 'mass_damping': 16, 'gravity_z': 0,
                           'publish_rate': 50}.items():
            self.assertEqual(self.initial[key], value, key)

    def test_a_stiffer_body_bends_less(self):
        self.body.pull(TIP, force=(0.5, 0, 0))
        self.body.wait_acting(1)
        soft = self.body.probe(self.body.step(SETTLED), 'tip') - TIP
        self.live.update_configuration({'young': 4e5})
        stiff = self.body.probe(self.body.step(SETTLED), 'tip') - TIP
        self.assertAlmostEqual(stiff[0] / soft[0], 0.5, delta=0.005)

    def test_weight_follows_gravity_and_density(self):
        self.live.update_configuration({'gravity_z': -10, 'density': 250})
        self.body.step(SETTLED)
        self.assertClose(self.body.wall()[0], [0, 0, 0.16 * 250 * 10], 1)

    def test_keeps_its_settings_where_the_new_ones_make_no_sense(self):
        for bad in ({'young': 0}, {'poisson': 0.5}, {'density': -1}, {'gravity_x': float('nan')}):
            answer = self.live.update_configuration(bad)
            for key in bad:
                self.assertEqual(answer[key], self.initial[key], key)


if __name__ == '__main__':
    rospy.init_node('node_test')
    rostest.rosrun('bezier_fem', 'node', NodeTest, sys.argv)
