#!/usr/bin/python3
"""A node that does nothing but keep the time: what a module that is off is measured against (design §6)."""

import rospy

if __name__ == "__main__":
    rospy.init_node("idle")
    rospy.spin()
