# SPDX-License-Identifier: Apache-2.0
"""A page on which a robot is taught a skill, and runs it: it talks to the graph by topics, services and actions."""
