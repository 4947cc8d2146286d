"""Builds a package of messages for rclpy that no package index has.

Run it with the Python of an environment that has rclpy; the arguments are the folder of the
package, one to build in, and the packages whose messages it uses. It generates the code with
ROS's own generators, compiles it, and installs it into the environment. It needs a C and a C++
compiler and the headers of Python.
"""

import glob
import os
import pathlib
import shutil
import subprocess
import sys
import sysconfig

os.environ["AMENT_PREFIX_PATH"] = sys.prefix

import numpy
from rosidl_generator_c.cli import GenerateC
from rosidl_generator_py.cli import GeneratePython
from rosidl_typesupport_c.cli import GenerateCTypesupport
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

PREFIX = pathlib.Path(sys.prefix)
LIBRARIES = PREFIX / "lib"


def generate(name, source, build):
    """Writes the code for the definitions of a package in `source` to `build`."""
    kinds = (
        GenerateC,
        GenerateCTypesupport,
        GenerateFastRTPSCTypesupport,
        GenerateIntrospectionCTypesupport,
        GeneratePython,
    )
    files = [f"{source}:msg/{path.name}" for path in sorted((source / "msg").glob("*.idl"))]
    for kind in kinds:
        kind(kind.__name__).generate(name, files, [str(PREFIX / "share")], build)


def link(compiler, output, sources, libraries, include):
    """Compiles `sources` into a shared library."""
    sources = [path for pattern in sources for path in sorted(glob.glob(str(pattern)))]
    assert sources, output
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-w", *[f"-I{path}" for path in include], *sources]
        + ["-o", str(output), f"-L{LIBRARIES}", *libraries],
        check=True,
    )


def main(source, build, packages):
    name = source.name
    shutil.rmtree(build, ignore_errors=True)
    package = build / name
    package.mkdir(parents=True)
    generate(name, source, package)
    include = [build, PREFIX / "include", *sorted((PREFIX / "include").iterdir())]
    include += [sysconfig.get_paths()["include"], numpy.get_include()]
    code = package / "msg"
    own = f"-l{name}__rosidl_generator_c"
    fastcdr = sorted(glob.glob(str(LIBRARIES / "libfastcdr.so*")))[0]

    def used(kind):
        return [f"-l{package}__{kind}" for package in packages]

    def library(kind, compiler, sources, *libraries):
        output = LIBRARIES / f"lib{name}__{kind}.so"
        link(compiler, output, sources, libraries, include)

    library(
        "rosidl_generator_c",
        "cc",
        [code / "detail/*__functions.c", code / "detail/*__description.c"],
        *used("rosidl_generator_c"),
        "-lrosidl_runtime_c",
        "-lrcutils",
    )
    library(
        "rosidl_typesupport_fastrtps_c",
        "c++",
        [code / "detail/*__type_support_c.cpp"],
        own,
        *used("rosidl_typesupport_fastrtps_c"),
        "-lrosidl_typesupport_fastrtps_c",
        "-lrosidl_typesupport_fastrtps_cpp",
        fastcdr,
    )
    library(
        "rosidl_typesupport_introspection_c",
        "cc",
        [code / "detail/*__type_support.c"],
        own,
        *used("rosidl_typesupport_introspection_c"),
        "-lrosidl_typesupport_introspection_c",
    )
    library(
        "rosidl_typesupport_c",
        "c++",
        [code / "*__type_support.cpp"],
        own,
        "-lrosidl_typesupport_c",
    )
    library(
        "rosidl_generator_py",
        "cc",
        [code / "_*_s.c"],
        own,
        *used("rosidl_generator_py"),
    )
    installed = pathlib.Path(sysconfig.get_paths()["purelib"]) / name
    (installed / "msg").mkdir(parents=True, exist_ok=True)
    (installed / "__init__.py").touch()
    for path in code.glob("*.py"):
        shutil.copy(path, installed / "msg")
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    link(
        "cc",
        installed / f"{name}_s__rosidl_typesupport_c{suffix}",
        [package / f"_{name}_s.ep.rosidl_typesupport_c.c"],
        [
            f"-l{name}__rosidl_generator_py",
            f"-l{name}__rosidl_typesupport_c",
            own,
            "-lrosidl_typesupport_c",
        ],
        include,
    )


main(*[pathlib.Path(path).resolve() for path in sys.argv[1:3]], sys.argv[3:])
