"""URDF and MJCF files for tests."""

from __future__ import annotations

from pathlib import Path

INERTIA = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.04"/>'
LINK = f'<inertial><origin xyz="0.5 0 0"/><mass value="2"/>{INERTIA}</inertial>'
INERTIAL = '<inertial pos="0.5 0 0" mass="2" diaginertia="0.02 0.03 0.04"/>'

ARM = f"""
<robot name="arm">
  <link name="base"/>
  <link name="upper">{LINK}</link>
  <link name="lower">{LINK}</link>
  <link name="tool"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 1" rpy="1.5707963267948966 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="2" effort="30" velocity="3"/><dynamics damping="0.5" friction="0.2"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/><child link="lower"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/><origin xyz="1 0 0"/></joint>
</robot>
"""


def written(tmp_path: Path, text: str | bytes, name: str = "file.xml") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def mjcf(body: str, rest: str = "") -> str:
    return f"<mujoco><worldbody>{body}</worldbody>{rest}</mujoco>"


def urdf(inertia: str, mass: float = 2.0, joint: str = "continuous", rest: str = "") -> str:
    inertial = f'<inertial><origin rpy="0.3 0.2 0.1"/><mass value="{mass}"/>{inertia}</inertial>'
    return (
        f'<robot name="r"><link name="a"/><link name="b">{inertial}</link><joint name="j" type="{joint}">'
        f'<parent link="a"/><child link="b"/><origin xyz="1 0 0"/></joint>{rest}</robot>'
    )


def moments(xx: float, yy: float, zz: float) -> str:
    return f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/>'


def bar(name: str, mass: float, length: float, parent: str, at: float) -> str:
    thin = mass * length**2 / 12.0
    inertial = f'<origin xyz="{length / 2} 0 0"/><mass value="{mass}"/>{moments(0.0, thin, thin)}'
    return (
        f'<link name="{name}"><inertial>{inertial}</inertial></link><joint name="{name}" type="continuous">'
        f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{at} 0 0"/><axis xyz="0 -1 0"/></joint>'
    )


def fixed(name: str, parent: str, at: float) -> str:
    joint = f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{at} 0 0"/>'
    return f'<link name="{name}"/><joint name="{name}_fixed" type="fixed">{joint}</joint>'
