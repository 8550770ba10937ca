"""Checks of a rig and a part before anything is rendered: findings with numbers and advice."""

from lightopt.preflight._check import check_rig, check_scene
