// SPDX-License-Identifier: Apache-2.0
// Surfels as a PLY file in the layout of 3D Gaussian splatting.
#pragma once

#include <filesystem>

#include <relidar/base/files.hpp>

namespace relidar {

struct Scene;
struct Surfels;
enum class Primitive;

/// All surfels of a scene as PLY in the layout of 3D Gaussian splatting, every property a
/// little-endian float:
///   x y z, nx ny nz (the surfel's normal), f_dc_0..2, f_rest_0..44 (intensity in all three colours: value = 0.5 + basis . coefficients,
///   f_rest_{15 c + k - 1} = coefficient k of colour c), opacity (logit), scale_0..2 (ln metres; the third, across a surfel, ln 1e-4),
///   rot_0..3 (w x y z), then what the layout has no place for: hit_0..15 and drop_0..15 (coefficients of the two logits), model (index).
/// Positions are in the frame of each surfel's model: actors stand at the origin. @throws
/// DataError as for write_atomically
void write_surfel_ply(const std::filesystem::path& path, const Scene& scene);
/// The same of surfels that are in one frame, as freeze() makes them: without `model`, so
/// that nobody takes them for a scene that can be read back. @param notes  comments
void write_surfel_ply(const std::filesystem::path& path, const Surfels& surfels, const FileNotes& notes);
/// Reads it back: bit-equal surfels, grouped by model, with the models, instances and
/// sensor-level ray-drop of `layout`. Properties may come in any order and others may be
/// there; nx ny nz, scale_2 of surfels and the second and third colour are not read.
/// @param primitive  of the surfels in the file; not given: surfels
/// @throws DataError for text or big-endian files, missing properties, sizes that do not
/// match, values that are not finite
Scene read_surfel_ply(const std::filesystem::path& path, const Scene& layout, Primitive primitive = {});

}  // namespace relidar
