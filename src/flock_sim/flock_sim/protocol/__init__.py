# SPDX-License-Identifier: Apache-2.0
"""The step protocol as state machines without I/O: messages in, messages out."""
