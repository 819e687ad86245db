"""Files that are refused: each message has the names, what is allowed, and what to do."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest
from imported_texts import ARM, INERTIAL, LINK, mjcf, written

import mbfmu as mb
from mbfmu.formats.imported import source_code
from mbfmu.util import extras

BOMB = b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><mujoco model="&b;"><worldbody/></mujoco>'
MESH = '<geom type="mesh" mesh="shell"/>'
ASSET = '<asset><mesh name="shell" file="shell.stl"/></asset>'


def robot(*joints: str, links: str = "abc") -> str:
    return (
        "<robot name='r'>"
        + "".join(f"<link name='{name}'>{LINK}</link>" for name in links)
        + "".join(joints)
        + "</robot>"
    )


def joint(name: str, parent: str, child: str, rest: str = "", kind: str = "continuous") -> str:
    ends = f"<parent link='{parent}'/><child link='{child}'/>"
    return f"<joint name='{name}' type='{kind}'>{ends}{rest}</joint>"


GOOD = joint("j", "a", "b")
REFUSED_URDF = [
    (robot(GOOD, links="aab"), r"several links have the same name \(a\)"),
    (robot(GOOD, joint("j", "b", "c")), r"several joints have the same name \(j\)"),
    (robot("<link/>", GOOD), "<link> number 4 has no name"),
    (robot(joint("j", "a", "d")), "the child of joint 'j' is 'd', which is no link of the file; allowed: a, b, c"),
    (robot(joint("j", "", "b")), "joint 'j' has no parent; write <parent link="),
    (robot(joint("j", "a", "b", kind="hinge")), "joint 'j' has the type 'hinge'; allowed: continuous, fixed, "),
    (robot(joint("j", "a", "b", kind="revolut")), "did you mean 'revolute'"),
    (robot(GOOD, joint("k", "c", "b")), "link 'b' is the child of the joints 'j' and 'k'; allowed: one joint"),
    (robot(joint("j", "a", "b"), joint("k", "b", "c"), joint("l", "c", "a")), r"joints form a cycle .*--close"),
    (robot(joint("j", "a", "a")), r"joints form a cycle \(j\)"),
    (
        robot(joint("j", "a", "b", "<origin xyz='0,1 0 0'/>")),
        r"<origin xyz='0,1 0 0'> of joint 'j'; allowed: 3 numbers",
    ),
    (
        robot(joint("j", "a", "b", "<dynamics damping='1,5'/>")),
        "<dynamics damping='1,5'> of joint 'j'; allowed: a number",
    ),
    (robot(joint("j", "a", "b", "<origin xyz='0 1'/>")), "allowed: 3 numbers separated by spaces"),
    (robot(joint("j", "a", "b", "<mimic joint='x'/>")), "joint 'j' follows the joint 'x'; allowed: another joint"),
    (robot(joint("j", "a", "b", "<origin xyz='${x} 0 0'/>")), r"the expression <origin xyz='\$\{x\} 0 0'> of xacro"),
    (robot(joint("j", "a", "b"), links="ab").replace('value="2"', 'value="1e309"'), "too large in attribute 'value'"),
]


def servo(attributes: str) -> str:
    """A servo with a limit of its force."""
    actuator = f"<position name='u' joint='j' kp='2' forcerange='-1 1' {attributes}/>"
    return mjcf(f"<body><joint name='j'/>{INERTIAL}</body>", f"<actuator>{actuator}</actuator>")


def tendons(factor: str) -> str:
    """Two joints that an equality constraint of tendons couples by a polynomial."""
    bodies = "".join(f"<body name='{k}'><joint name='j{k}'/>{INERTIAL}</body>" for k in "ab")
    factors = {"a": "1", "b": factor}
    paths = "".join(f"<fixed name='{k}'><joint joint='j{k}' coef='{c}'/></fixed>" for k, c in factors.items())
    equality = "<equality><tendon name='e' tendon1='a' tendon2='b' polycoef='0 1 1 0 0'/></equality>"
    return mjcf(bodies, f"<tendon>{paths}</tendon>{equality}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "is empty"),
        (b" \n ", "is empty"),
        (b"solid mesh", "is not valid XML"),
        (b"\x00\x01\xff\xfe", "is not UTF-8 text at byte 2"),
        ('<?xml version="1.0" encoding="ISO-8859-1"?><robot name="é"/>'.encode("latin-1"), "is not UTF-8 text"),
        (mjcf("<body><joint/><geom size='.1' pos='nan 0 0'/></body>"), "such as <geom pos='nan 0 0'>"),
        (b"<mujoco><worldbody>", "is not valid XML"),
        (BOMB, "document type or entities"),
        (b"<sdf version='1.6'/>", "has the root element <sdf>; allowed: <robot> of URDF and <mujoco> of MJCF"),
        (b"<mujoco/>", "has no joint that moves a body"),
        (b"<robot name='r'><link name='a'/></robot>", "has no joint that moves a body"),
        (mjcf("<body><joint/><weel/></body>"), "unrecognized element; Element 'weel', line 1"),
        (mjcf("<body name='arm'><joint/></body>"), "Element name 'arm'.* Give this body a mass"),
        (mjcf("<body name='arm'><joint/><inertial pos='0 0 0' mass='1' diaginertia='1 1 3'/></body>"), "A . B >= C"),
        (mjcf(f"<body><joint axis='0 0 0'/>{INERTIAL}</body>"), "axis too small"),
        (mjcf(f"<body><joint damping='inf'/>{INERTIAL}</body>"), "damping of joint 'number 1' is not finite"),
        (mjcf(f"<body><joint ref='nan'/>{INERTIAL}</body>"), "such as <joint ref='nan'>"),
        (mjcf(f"<body name='arm'><joint/>{MESH}</body>", ASSET), r"body 'arm' has its mass and inertia from the mesh"),
        ("<robot name='r' xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:a/></robot>", "contains <a> of xacro"),
        (f"<robot name='r'><link name='a'/><link name='b'>{LINK}</link><joint name='j' type='revolute'>"
         "<parent link='a'/><child link='c'/></joint></robot>", "the child of joint 'j' is 'c', which is no link"),
        (mjcf("<body/>" * 20_001), "has 20001 bodies; allowed: up to 20000"),
        (mjcf(f"<replicate count='30000'><body><joint/>{INERTIAL}</body></replicate>"), "bodies; allowed: up to 20000"),
        (mjcf(f"<replicate count='1000000000'><body><joint/>{INERTIAL}</body></replicate>"), "has 1e[+]09 bodies"),
        (mjcf("<body><composite type='cable' count='100000 1 1' size='1'/></body>"), "has 100001 bodies; allowed"),
        ("<robot " + " ".join(f"a{k}=''" for k in range(5000)) + "/>", "element <robot> of 5000 attributes; allowed"),
        (robot(GOOD).replace(LINK, LINK + "<visual><geometry><sphere radius='nan'/></geometry></visual>", 2),
         "size of a is not a finite number"),
        (mjcf(f"<body name='a'><joint/>{INERTIAL}</body>" * 2), "repeated name 'a' in body.* Give each element"),
        (mjcf(f"<body pos='0,1 0 0'><joint/>{INERTIAL}</body>"), "bad format in attribute 'pos'.* with a point"),
        (mjcf(f"<body><joint type='revolute'/>{INERTIAL}</body>"), "keyword: 'revolute'.* free, ball, slide or hinge"),
        (mjcf(f"<body><joint/>{INERTIAL}</body>", "<actuator><motor joint='x'/></actuator>"), "Check this name"),
        (mjcf(f"<body gravcomp='1'><joint/>{INERTIAL}</body>").replace('mass="2"', 'mass="1e308"'), "is not a finite"),
        (servo("gear='1e308'"), "(gain|stiffness) of u is not a finite"),
        (servo("gear='1e200'").replace("forcerange='-1 1'", ""), "stiffness of u is not a finite"),
        (servo("armature='1e300' gear='1e10'"), "armature of j is not a finite"),
        (mjcf(f"<body><joint name='j' range='-1 1' solreflimit='1e-200 1'/>{INERTIAL}</body>"), "stiffness of j is"),
        (mjcf(f"<body><joint ref='1e308'/>{INERTIAL}</body>"), "ref of a joint is .* rad; allowed: angles up to"),
        (tendons("1e300"), "coefficients of e is not a finite"),
        *REFUSED_URDF,
    ],
)  # fmt: skip
def test_files_that_are_no_models_are_refused(tmp_path: Path, text: str | bytes, message: str) -> None:
    begin = time.process_time()
    with pytest.raises(mb.UserError, match=message):
        source_code(written(tmp_path, text))
    assert time.process_time() - begin < 5.0
    assert [path.name for path in tmp_path.iterdir()] == ["file.xml"], "MuJoCo writes no log"


def test_chains_that_would_take_hours_are_refused(tmp_path: Path) -> None:
    joints = "".join(
        f'<link name="l{i}">{LINK}</link><joint name="j{i}" type="continuous"><parent link="l{i - 1}"/>'
        f'<child link="l{i}"/></joint>'
        for i in range(1, 25_000)
    )
    path = written(tmp_path, f'<robot name="r"><link name="l0"/>{joints}</robot>', "chain.urdf")
    with pytest.raises(mb.UserError, match="has 25000 bodies"):
        source_code(path)
    path.write_text('<robot name="r"><link name="l0"/>' + joints[: joints.index('<link name="l2000"')] + "</robot>")
    with pytest.raises(mb.UserError, match="has a chain of 1999 joints; allowed: up to 1000"):
        source_code(path)


def test_paths_that_are_no_files_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.urdf", Path("/dev/null"), Path("a\0b")):
        with pytest.raises(mb.UserError, match=r"cannot be read|is empty"):
            mb.load(path)


def test_a_mesh_that_has_no_part_in_the_motion_may_be_missing(tmp_path: Path) -> None:
    path = written(tmp_path, mjcf(f"<body><joint/>{INERTIAL}{MESH}</body>", ASSET))
    assert [d.text.split(" (")[0] for d in source_code(path)[1]] == [
        "not imported: contact between shapes",
        "meshes are not drawn",
    ]


def test_warnings_of_mujoco_are_notes(tmp_path: Path) -> None:
    text = mjcf(f"<body><joint/>{INERTIAL}</body>", "<compiler settotalmass='4'/>")
    (found,) = source_code(written(tmp_path, text), strict=True)[1]
    assert found.severity == "note"
    assert "MuJoCo reports: compiler attribute 'settotalmass' is deprecated" in found.text


def test_numbers_of_other_elements_are_not_checked(tmp_path: Path) -> None:
    """Such as <verbose value="Yes"/> of the PR2."""
    text = robot(GOOD, links="ab").replace("</link>", '<verbose value="Yes"/></link>', 1)
    assert "<verbose>" in source_code(written(tmp_path, text))[1][0].text


def test_an_old_version_of_mujoco_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = type(sys)("mujoco")
    old.__version__ = "3.3.7"  # type: ignore[attr-defined]
    monkeypatch.setattr(extras, "import_module", lambda _: old)
    with pytest.raises(mb.UserError, match=r"mujoco 3\.3\.7 is installed; 4\.0 or newer is required"):
        source_code(written(tmp_path, ARM))
