# SPDX-License-Identifier: Apache-2.0
"""The task file: which frames, which topics, which model; read key by key."""
