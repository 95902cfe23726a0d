"""Files of others that describe skins, made here as their makers write them."""

from pathlib import Path

#: Pads of a triangle of the iCub in millimetres around pad 3; pads 6 and 10 measure temperature.
PADS_MM = (
    (6.5, 0.0), (9.8, -5.7), (3.3, -5.7), (0.0, 0.0), (-3.3, -5.7), (-9.8, -5.7),
    (-6.5, -3.7), (-6.5, 0.0), (-3.3, 5.7), (0.0, 11.3), (0.0, 7.5), (3.3, 5.7),
)  # fmt: skip
NO_TAXEL = "0 0 0 0 0 0"


def icub(folder: Path, modules: dict[int, str], lines: dict[int, str] | None = None) -> tuple[Path, Path]:
    """Write a part of four modules in a row; modules that are not named have no positions."""
    channels = []
    for module in range(4):
        for x, y in PADS_MM:
            place = f"{0.001 * x + 0.03 * module:.4f} {0.001 * y:.4f} 0.0000 0 0 1"
            channels.append(place if module in modules else NO_TAXEL)
    for number, line in (lines or {}).items():
        channels[number] = line
    positions, names = folder / "arm.txt", folder / "arm.ini"
    positions.write_text("\n".join(["name arm", "taxel2Repr (3 3 3)", "[calibration]", *channels]) + "\n")
    kinds = [f"{kind} {module} 10.0 20.0 -90 5 1" for module, kind in modules.items()]
    names.write_text("\n".join(["robotPart arm", "[SENSORS]", "# number x y", *kinds]) + "\n")
    return positions, names


#: Two skins of taxels on a robot, as URDF.
URDF = """<robot name="hand">
  <link name="base"/><link name="palm"/><link name="tip"/>
  <joint name="a" type="fixed"><parent link="base"/><child link="palm"/><origin xyz="0 0 0.1" rpy="0 0 0"/></joint>
  <joint name="b" type="revolute"><parent link="palm"/><child link="tip"/>
    <origin xyz="0.05 0 0" rpy="0 1.5708 0"/></joint>
  <sensor name="palm"><parent link="palm"/><origin xyz="0 0 0.01"/>
    <tactile><array rows="2" cols="3" order="{order}" size="0.004 0.005" offset="0.001 0"/></tactile></sensor>
  <sensor name="tip"><parent link="tip"/>
    <tactile channel="tip"><taxel idx="1" xyz="0.002 0 0" rpy="0 0 0"/><taxel idx="0" xyz="0 0 0"/></tactile></sensor>
</robot>"""


#: A drive with a cyclic message, one of 29 bits, and one without a period.
DBC = """VERSION ""
NS_ :
BS_:
BU_: Drive
BO_ 389 Status: 6 Drive
 SG_ Word : 0|16@1+ (1,0) [0|65535] "" Drive
BO_ 2566848770 Far: 8 Drive
 SG_ Far1 : 0|16@1+ (1,0) [0|65535] "" Drive
BO_ 1413 Answer: 8 Drive
BO_ 2566848771 Long: 39 Drive
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 389 10;
BA_ "GenMsgCycleTime" BO_ 2566848770 100;
BA_ "GenMsgCycleTime" BO_ 2566848771 100;
"""
