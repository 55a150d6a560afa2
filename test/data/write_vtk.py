#!/usr/bin/env python3
"""Writes what two_boxes*.vtk (from Gmsh) hold with VTK's own writers; needs python3-vtk9."""

from vtkmodules.vtkCommonCore import vtkStringArray
from vtkmodules.vtkIOLegacy import vtkUnstructuredGridReader, vtkUnstructuredGridWriter
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter


def read(path):
    reader = vtkUnstructuredGridReader()
    reader.SetFileName(path)
    reader.Update()
    grid = reader.GetOutput()
    field = vtkStringArray()  # comes before the points in a legacy file
    field.SetName("author")
    field.InsertNextValue("POINTS of view")
    grid.GetFieldData().AddArray(field)
    return grid


def write_legacy(grid, name, version, binary):
    writer = vtkUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileName(name + ".vtk")
    writer.SetFileVersion(version)
    writer.SetFileType(2 if binary else 1)
    writer.Write()


def write_xml(grid, name, mode, header=32, zlib=False, base64=True, order="Little"):
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileName(name + ".vtu")
    getattr(writer, "SetDataModeTo" + mode)()
    getattr(writer, f"SetHeaderTypeToUInt{header}")()
    getattr(writer, f"SetByteOrderTo{order}Endian")()
    writer.SetCompressorTypeToZLib() if zlib else writer.SetCompressorTypeToNone()
    writer.SetBlockSize(512)  # several blocks an array, as large meshes have
    writer.SetEncodeAppendedData(base64)
    writer.Write()


first, second = read("two_boxes.vtk"), read("two_boxes_o2.vtk")
for name, grid in ("two_boxes", first), ("two_boxes_o2", second):
    write_legacy(grid, name + "_51", 51, False)
    write_xml(grid, name + "_ascii", "Ascii")
write_legacy(second, "two_boxes_o2_42_binary", 42, True)
write_legacy(second, "two_boxes_o2_51_binary", 51, True)
write_xml(second, "two_boxes_o2_binary", "Binary")
write_xml(second, "two_boxes_o2_binary64_zlib", "Binary", header=64, zlib=True)
write_xml(second, "two_boxes_o2_raw64", "Appended", header=64, base64=False)
write_xml(second, "two_boxes_o2_raw_zlib", "Appended", zlib=True, base64=False)
write_xml(second, "two_boxes_o2_base64_big", "Appended", order="Big")
write_xml(second, "two_boxes_o2_base64_zlib", "Appended", header=64, zlib=True)
