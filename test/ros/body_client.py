"""What the tests of the node have in common: a client of one deformable_node that waits and never sleeps blindly."""
import threading
import time

import numpy as np
import rospy
from bezier_fem.msg import BodyState, PointWrench
from bezier_fem.srv import Step
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, Vector3, WrenchStamped
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

PATIENCE = 20.0  # s, real


def xyz(vector):
    return np.array([vector.x, vector.y, vector.z])


class Inbox:
    """The last message of a topic, and waiting for one that is as it should be."""

    def __init__(self, topic, kind):
        self.topic = topic
        self.messages = []
        self.changed = threading.Condition()
        self.subscriber = rospy.Subscriber(topic, kind, self.put, queue_size=100, tcp_nodelay=True)

    def put(self, message):
        with self.changed:
            self.messages.append(message)
            del self.messages[:-200]
            self.changed.notify_all()

    def clear(self):
        with self.changed:
            self.messages.clear()

    def wait(self, what, accept=lambda message: True, patience=PATIENCE):
        """The first message since the last clear() that is accepted."""
        deadline = time.monotonic() + patience
        seen = 0
        with self.changed:
            while True:
                for message in self.messages:
                    if accept(message):
                        return message
                seen = len(self.messages)
                left = deadline - time.monotonic()
                if left <= 0:
                    raise AssertionError('%s: no %s among the last %d messages' % (self.topic, what, seen))
                self.changed.wait(left)


class Body:
    def __init__(self, name):
        self.name = name
        self.state = Inbox(name + '/state', BodyState)
        self.forces = Inbox(name + '/forces', MarkerArray)
        self.reaction = Inbox(name + '/reaction/wall', WrenchStamped)
        self.diagnostics = Inbox('/diagnostics', DiagnosticArray)
        self.services = {}
        for service, kind in (('reset', Trigger), ('set_paused', SetBool), ('step', Step)):
            rospy.wait_for_service(name + '/' + service, PATIENCE)
            self.services[service] = rospy.ServiceProxy(name + '/' + service, kind)
        self.point_wrench = self.publisher('point_wrench', PointWrench)

    def publisher(self, topic, kind, latch=False):
        """One that is heard, by the node if nobody else listens to the topic."""
        publisher = rospy.Publisher(rospy.names.ns_join(self.name, topic), kind, queue_size=100, latch=latch)
        deadline = time.monotonic() + PATIENCE
        while publisher.get_num_connections() == 0:
            if time.monotonic() > deadline:
                raise AssertionError('nobody listens to ' + topic)
            time.sleep(0.01)
        return publisher

    def restart(self):
        """Paused, at rest, with nothing acting."""
        self.pause(True)
        answer = self.services['reset']()
        assert answer.success, answer.message
        # What was sent before the reset may still be on its way
        self.state.clear()
        self.state.wait('state at the start', lambda s: s.step == 0 and s.real_time_factor == 0)
        self.wait_acting(0)
        self.wait_acting(0, 'contacts')
        self.state.clear()

    def pause(self, paused):
        return self.services['set_paused'](paused)

    def step(self, steps):
        """Makes so many steps and returns the state after them."""
        for inbox in (self.state, self.reaction):
            inbox.clear()
        answer = self.services['step'](steps)
        assert answer.success, answer.message
        self.last = self.state.wait('state of t = %g s' % answer.time, lambda s: abs(s.time - answer.time) < 1e-9)
        return self.last

    def wall(self):
        """What the region named wall takes up in the state that step() returned: force, torque about the origin."""
        message = self.reaction.wait('reaction', lambda r: r.header.stamp == self.last.header.stamp)
        assert message.header.frame_id == 'world'
        return xyz(message.wrench.force), xyz(message.wrench.torque)

    def probe(self, state, name):
        return xyz(state.probes[state.probe_names.index(name)])

    def pull(self, point, force=(0, 0, 0), torque=(0, 0, 0), frame='world', stamp=None, name=''):
        message = PointWrench()
        message.header.frame_id = frame
        message.header.stamp = stamp or rospy.Time()
        message.id = name
        message.point = Point(*point)
        message.wrench.force = Vector3(*force)
        message.wrench.torque = Vector3(*torque)
        self.point_wrench.publish(message)

    def wait_acting(self, count, namespace='wrenches'):
        """Until so many arrows are shown: the node has taken what was sent. Returns them."""
        def arrows(message):
            return [m for m in message.markers if m.ns == namespace and m.action == Marker.ADD]
        self.forces.clear()
        return arrows(self.forces.wait('%d %s' % (count, namespace), lambda m: len(arrows(m)) == count))

    def diagnosis(self, task, what, accept):
        """The values of one task of /diagnostics, once they are accepted."""
        found = {}

        def check(message):
            for status in message.status:
                if status.name == self.name.strip('/') + ': ' + task:
                    found.clear()
                    found.update({v.key: v.value for v in status.values}, level=status.level, message=status.message)
                    return accept(found)
            return False
        self.diagnostics.clear()
        self.diagnostics.wait(what, check)
        return found
