"""The URDF as text: whatever it looks like, only edited origin numbers change; what cannot be read says why."""

import math
import re

import pytest

from calib.core.base.errors import UrdfError
from calib.core.robots.urdf.text import parse_urdf, read_urdf

UGLY = """<?xml version="1.0" ?>
<!-- made by hand: <origin xyz="9 9 9"/> in a comment is not an origin -->
<robot name="garçon" xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:property name="leftover" value="${pi/2}"/>
  <xacro:macro name="never_called"><joint name="j1" type="fixed"><origin xyz="7 7 7"/></joint></xacro:macro>
  <gazebo reference="l1"><joint name="j1"><origin xyz="8 8 8"/></joint></gazebo>
  <joint type='prismatic' name='überschlitten'>
    <limit upper="+.5" lower="-1e-3" effort="0" velocity="1"/>
    <axis xyz="0 0 2"/>
    <origin rpy = '0.1  -2.5E-1\t1e-05' xyz =
      "1.000  -0 .5"/>   <!-- a > sign, and "quotes" -->
    <child link="schlitten"/><parent link="l1"/>
    <dynamics damping="0.1"/>
  </joint>
  <link name="schlitten"><visual><origin xyz="3 3 3"/><geometry><mesh filename="package://a/b c.dae" scale="1 1 1"/>
    </geometry></visual></link>
  <transmission name="t"><joint name="j1"><hardwareInterface>x</hardwareInterface></joint></transmission>
  <joint name="follower" type="revolute"><parent link="schlitten"/><child link="l3"/>
    <mimic offset="0.5" joint="überschlitten" multiplier="-2"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <link name="l3"/>
  <joint name="loose" type="floating"><!-- <joint name='no'/> --><origin	xyz="0 0 1"></origin
    ><parent link="l3"/><child link="l4"/></joint>
  <link name="l4"><inertial><origin xyz="5 5 5" rpy="1 1 1"/><mass value="1"/></inertial></link>
  <joint name="wheel" type="continuous"><parent link="l4"/><child link="l5"/><origin/>
    <limit lower="0" upper="0" effort="1" velocity="1"/></joint>
  <link name="l5"/><link name="l1"/>
</robot>
<!-- the end -->
"""
VARIANTS = {
    "as written": UGLY.encode(),
    "CRLF": UGLY.replace("\n", "\r\n").encode(),
    "BOM": b"\xef\xbb\xbf" + UGLY.encode(),
    "BOM and CRLF": b"\xef\xbb\xbf" + UGLY.replace("\n", "\r\n").encode(),
    "Latin-1": UGLY.replace('version="1.0"', 'version="1.0" encoding="iso-8859-1"').encode("latin-1"),
    "no line ends": UGLY.replace("\n", " ").encode(),
    "no final line end": UGLY.rstrip().encode(),
}


@pytest.fixture(params=VARIANTS, ids=lambda name: name.replace(" ", "_"))
def ugly(request):
    return parse_urdf(VARIANTS[request.param], "ugly.urdf")


def as_asked(urdf):
    return {joint.name: (joint.xyz, joint.rpy) for joint in urdf.joints}


def test_reads_everything_that_people_write(ugly):
    assert ugly.name == "garçon"
    assert ugly.root == "l1"
    assert ugly.links == ("schlitten", "l3", "l4", "l5", "l1")
    slide, follower, loose, wheel = ugly.joints
    assert (slide.name, slide.type, slide.parent, slide.child) == ("überschlitten", "prismatic", "l1", "schlitten")
    assert (slide.xyz, slide.rpy, slide.axis) == ((1.0, 0.0, 0.5), (0.1, -0.25, 1e-5), (0.0, 0.0, 1.0))
    assert (slide.lower, slide.upper) == (-1e-3, 0.5)
    assert follower.mimic == ("überschlitten", -2.0, 0.5)
    assert (follower.xyz, follower.rpy, follower.axis) == ((0.0,) * 3, (0.0,) * 3, (1.0, 0.0, 0.0))
    assert (loose.type, loose.xyz) == ("floating", (0.0, 0.0, 1.0))
    assert (wheel.lower, wheel.upper) == (-math.inf, math.inf)


def test_nothing_changes_where_nothing_is_edited(ugly):
    assert ugly.with_origins(as_asked(ugly)) == ugly.source
    assert ugly.with_origins({}) == ugly.source


@pytest.mark.parametrize("joint", ["überschlitten", "follower", "loose", "wheel"])
def test_an_edit_reads_back_and_touches_nothing_but_its_origin(ugly, joint):
    new = ((0.1, -2.0, 1 / 3), (1e-9, 0.25, -3.0))
    edited = ugly.with_origins({joint: new})
    expected = as_asked(ugly) | {joint: new}
    assert as_asked(parse_urdf(edited)) == expected
    span = next(j for j in ugly.joints if j.name == joint).origin_span
    if span is not None:
        assert edited[: span[0]] == ugly.source[: span[0]]
        assert edited.endswith(ugly.source[span[1] :])
    else:  # one tag was added, nothing else
        added = re.search(rb'\s*<origin xyz="0.1 -2.0 0.333[^>]*>', edited)
        assert added is not None
        assert edited.replace(added.group(), b"", 1) == ugly.source


def test_numbers_of_an_edited_origin_that_stay_keep_their_spelling():
    urdf = parse_urdf(VARIANTS["as written"])
    edited = urdf.with_origins({"überschlitten": ((1.0, -0.125, 0.5), (0.1, -0.25, 1e-5))})
    assert edited == urdf.source.replace(b'"1.000  -0 .5"', b'"1.000  -0.125 .5"')


def test_a_missing_origin_is_added_on_its_own_line_with_the_line_ends_of_the_file():
    source = (
        b'<robot name="r">\r\n  <link name="a"/>\r\n  <link name="b"/>\r\n  <joint name="j" type="fixed">\r\n'
        b'    <parent link="a"/>\r\n    <child link="b"/>\r\n  </joint>\r\n</robot>\r\n'
    )
    edited = parse_urdf(source).with_origins({"j": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))})
    assert edited == source.replace(b'"fixed">', b'"fixed">\r\n    <origin xyz="0 0 1.0"/>')


TWO = '<robot name="r"><link name="a"/><link name="b"/>{}</robot>'
JOINT = '<joint name="j" type="{}"><parent link="a"/><child link="b"/>{}</joint>'
FIXED = JOINT.format("fixed", "")


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("", "not valid XML (no element found)"),
        ("<robot", "not valid XML"),
        ("\n<?xml version='1.0'?><robot/>", "must be the very first"),
        ("<robot></robot>", "no links"),
        ("<sdf version='1.6'/>", "the top element is <sdf>, not that of a robot"),
        (TWO.format(""), "several root links: a, b"),
        (TWO.format(JOINT.format("revolut", "")), "unknown type 'revolut'; did you mean 'revolute'?"),
        (TWO.format(JOINT.format("fixed", '<origin xyz="0 0"/>')), "joint 'j', xyz: '0 0' is not three numbers"),
        (TWO.format(JOINT.format("fixed", '<origin xyz="0, 0, 1"/>')), "'0,' is not a number"),
        (TWO.format(JOINT.format("fixed", '<origin xyz="0 0 nan"/>')), "'nan' is not a number"),
        (TWO.format(JOINT.format("fixed", '<origin xyz="0 0 1e999"/>')), "is not finite"),
        (TWO.format(JOINT.format("fixed", '<origin xyz="0 0 1_0"/>')), "'1_0' is not a number"),
        (TWO.format(JOINT.format("fixed", '<origin xyz="0\u00a00 1"/>')), "is not a number"),
        (TWO.format(JOINT.format("fixed", '<origin rpy="0 0 ${pi}"/>')), "xacro expression; run xacro"),
        (TWO.format(JOINT.format("fixed", '<origin quat_xyzw="0 0 1 0"/>')), "has 'quat_xyzw', which is not read"),
        (TWO.format(JOINT.format("fixed", '<origin xyz="0 0 1"/><origin/>')), "joint 'j' has two <origin>"),
        (TWO.format(JOINT.format("revolute", '<axis xyz="0 0 0"/>')), "axis has no direction"),
        (TWO.format(JOINT.format("fixed", '<mimic joint="k"/>')), "mimics no joint 'k'"),
        (TWO.format('<joint name="j" type="fixed"><child link="b"/></joint>'), "joint 'j': has no <parent>"),
        (TWO.format('<joint type="fixed"/>'), "<joint> has no 'name'"),
        (TWO.format('<joint name="" type="fixed"/>'), "<joint> has no 'name'"),
        (TWO.format(FIXED + FIXED), "joint 'j' is defined twice"),
        (TWO.format('<link name="a"/>'), "link 'a' is defined twice"),
        (TWO.format(FIXED.replace('"b"', '"bb"')), "no link 'bb'"),
        (TWO.format(FIXED + FIXED.replace('"j"', '"k"')), "child of joints 'j'"),
        (TWO.format(FIXED + '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>'), "ring"),
    ],
)
def test_what_cannot_be_read_says_what_and_where(source, words):
    with pytest.raises(UrdfError, match=re.escape(words)) as caught:
        parse_urdf(source.encode(), "some.urdf")
    assert str(caught.value).startswith("some.urdf")
    assert "\n" not in str(caught.value)


def test_a_ring_beside_the_tree_is_an_error():
    ring = "".join(
        f'<link name="{x}"/><joint name="{x}" type="fixed"><parent link="{y}"/><child link="{x}"/></joint>'
        for x, y in ("cd", "de", "ec")
    )
    with pytest.raises(UrdfError, match="its own ancestor"):
        parse_urdf(f'<robot name="r"><link name="a"/>{ring}</robot>'.encode())


def test_files_that_are_not_there_or_not_text_say_so(tmp_path):
    with pytest.raises(UrdfError, match="no such file"):
        read_urdf(tmp_path / "none.urdf")
    with pytest.raises(UrdfError, match="cannot be read"):
        read_urdf(tmp_path)
    for content in ("<robot/>".encode("utf-16"), b"\x7fELF\x00\x00"):
        with pytest.raises(UrdfError, match="UTF-16 or binary"):
            parse_urdf(content)
    with pytest.raises(UrdfError, match="encoding"):
        parse_urdf(b'<?xml version="1.0" encoding="gbk"?><robot/>')


def test_two_equal_tags_other_than_origin_are_no_matter():
    urdf = parse_urdf(TWO.format(JOINT.format("revolute", '<axis xyz="0 1 0"/><axis xyz="0 1 0"/>')).encode())
    assert urdf.joints[0].axis == (0.0, 1.0, 0.0)


def test_origins_in_xml_entities_read_and_are_refused_for_writing():
    joint = JOINT.format("fixed", "<origin xyz='0 0 1'/>").replace('"', "'")
    source = f'<!DOCTYPE robot [<!ENTITY j "{joint}">]>' + TWO.format("&j;")
    urdf = parse_urdf(source.encode())
    assert urdf.joints[0].xyz == (0.0, 0.0, 1.0)
    with pytest.raises(UrdfError, match="comes from an XML entity"):
        urdf.with_origins({"j": ((0.0, 0.0, 2.0), (0.0, 0.0, 0.0))})


def test_numbers_spelled_with_character_references_are_replaced_whole():
    urdf = parse_urdf(TWO.format(JOINT.format("fixed", '<origin xyz="1&#32;2&#x20;3"/>')).encode())
    edited = urdf.with_origins({"j": ((1.0, 2.0, 4.0), (0.0, 0.0, 0.0))})
    assert b'xyz="1.0 2.0 4.0"' in edited


def test_unknown_joints_and_numbers_that_are_not_finite_are_not_written():
    with pytest.raises(UrdfError, match="no joint 'jj'; did you mean 'j'"):
        parse_urdf(TWO.format(FIXED).encode()).with_origins({"jj": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))})
    with pytest.raises(UrdfError, match="joint 'j', xyz: 'nan' is not a number"):
        parse_urdf(TWO.format(FIXED).encode()).with_origins({"j": ((0.0, 0.0, math.nan), (0.0, 0.0, 0.0))})
