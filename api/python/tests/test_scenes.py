"""Uploads of every form, lists, and what is refused."""

from __future__ import annotations

import json
import struct
import zipfile
from pathlib import Path

import pytest

from lightshaft import Client, InvalidRequestError, NotFoundError, Scene

from .service import generate

SMALL = {"width": 32, "height": 32, "spp": 1}


def test_an_upload_is_told_of_as_it_goes_and_the_same_bytes_give_the_same_scene(client: Client, tmp_path: Path) -> None:
    path = generate(tmp_path, "soup", "--triangles", "20000")
    size, sent = path.stat().st_size, list[tuple[int, int]]()
    scene = client.upload_scene(path, name="a soup", on_sent=lambda done, total: sent.append((done, total)))
    assert (scene.bytes, scene.name, scene.meshes[0].triangles) == (size, "a soup", scene.triangles_total)
    assert len(sent) > 2
    assert sent == sorted(sent)
    assert sent[-1] == (size, size)
    assert client.upload_scene(path).id == scene.id
    assert client.scene(scene.id).hash == scene.hash
    client.delete_scene(scene.id)
    with pytest.raises(NotFoundError) as refused:
        client.scene(scene.id)
    assert (refused.value.status, refused.value.code) == (404, "not-found")
    assert refused.value.type == "/problems/not-found"
    assert refused.value.title
    assert refused.value.request_id


def _gltf(folder: Path, buffer: str = "data/triangle 1.bin") -> Path:
    file = folder / "data" / "triangle 1.bin"
    file.parent.mkdir()
    file.write_bytes(struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0))
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"uri": buffer.replace(" ", "%20"), "byteLength": 36}],
    }
    path = folder / "triangle.gltf"
    path.write_text(json.dumps(document))
    return path


def test_a_gltf_goes_with_its_files_and_a_zip_as_it_is(client: Client, tmp_path: Path) -> None:
    path = _gltf(tmp_path)
    assert client.upload_scene(path).triangles_total == 1
    packed = tmp_path / "triangle.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        for file in (path, tmp_path / "data" / "triangle 1.bin"):
            archive.write(file, file.relative_to(tmp_path))
    assert client.upload_scene(packed).triangles_total == 1


def test_what_is_wrong_with_a_scene_is_named(client: Client, tmp_path: Path) -> None:
    path = tmp_path / "broken.glb"
    path.write_bytes(b"glTF" + bytes(100))
    for send in (client.upload_scene, client.validate_scene):
        with pytest.raises(InvalidRequestError) as refused:
            send(path)
        assert (refused.value.status, refused.value.code) == (422, "invalid-scene")
    with pytest.raises(InvalidRequestError, match=r"missing\.bin"):
        client.upload_scene(_gltf(tmp_path, "missing.bin"))
    with pytest.raises(FileNotFoundError):
        client.upload_scene(tmp_path / "nowhere.glb")
    (tmp_path / "no.gltf").write_text("{")
    with pytest.raises(ValueError, match="not a glTF document"):
        client.upload_scene(tmp_path / "no.gltf")


def test_files_outside_the_folder_of_a_gltf_are_not_read(client: Client, tmp_path: Path) -> None:
    (tmp_path / "secret.bin").write_bytes(bytes(36))
    folder = tmp_path / "scene"
    folder.mkdir()
    for name in ("../secret.bin", str(tmp_path / "secret.bin")):
        with pytest.raises(InvalidRequestError):
            client.upload_scene(_gltf_at(folder, name))


def _gltf_at(folder: Path, buffer: str) -> Path:
    if not (folder / "data").exists():
        _gltf(folder)
    path = folder / "triangle.gltf"
    document = json.loads(path.read_text())
    document["buffers"][0]["uri"] = buffer
    path.write_text(json.dumps(document))
    return path


def test_validating_keeps_nothing(client: Client, scene: Scene, tmp_path: Path) -> None:
    path = generate(tmp_path, "staircase")
    before = client.status().scenes
    assert client.validate_scene(path).triangles_total > 0
    assert client.status().scenes == before


def test_lists_come_page_by_page(client: Client, scene: Scene, tmp_path: Path) -> None:
    other = client.upload_scene(generate(tmp_path, "furnace-sphere"))
    first = client.scenes(limit=1)
    assert len(first.items) == 1
    assert first.next_cursor
    second = client.scenes(limit=1, cursor=first.next_cursor)
    assert first.items[0].id != second.items[0].id
    ids = [scene.id for scene in client.iterate_scenes()]
    assert len(ids) == len(set(ids))
    assert {scene.id, other.id} <= set(ids)
    hashes = {mesh.hash for mesh in client.iterate_meshes()}
    assert {mesh.hash for mesh in scene.meshes} <= hashes
    assert client.meshes(limit=1).next_cursor


def test_a_thumbnail_that_is_not_there_is_not_found(client: Client, scene: Scene) -> None:
    with pytest.raises(NotFoundError):
        client.thumbnail(scene.id)
