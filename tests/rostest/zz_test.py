#!/usr/bin/python3
import nothing_such
