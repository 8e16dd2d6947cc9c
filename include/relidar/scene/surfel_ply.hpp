// SPDX-License-Identifier: Apache-2.0
// Reads and writes surfels as PLY files in the layout of 3D Gaussian splatting.
#pragma once

#include <filesystem>
#include <string>

#include <relidar/base/files.hpp>

namespace relidar {

struct Scene;
struct Surfels;
enum class PrimitiveType;

/// Writes all surfels of a scene as PLY in the layout of 3D Gaussian splatting. Every
/// property is a little-endian float:
///
///   x y z                 position
///   nx ny nz              normal of the surfel
///   f_dc_0..2             first coefficient of the three colours; all hold the intensity
///   f_rest_0..44          f_rest_{15 c + k - 1} = coefficient k of colour c;
///                         value = 0.5 + basis . coefficients
///   opacity               logit
///   scale_0..2            ln metres; the third, across a surfel, is ln 1e-4
///   rot_0..3              quaternion w x y z
///   hit_0..15, drop_0..15 coefficients of the two logits; not in the original layout
///   model                 index of the model; not in the original layout
///
/// Positions are in the frame of the surfel's model, so actors are at the origin.
/// @param comments comments in the file header
/// @throws DataError for the reasons listed at write_atomically()
void write_surfels(const std::filesystem::path& path, const Scene& scene, const FileMetadata& comments = {});
/// Writes surfels that are all in the same coordinate frame. The file has no property
/// `model`, so that read_surfel_ply() does not read it as a complete scene.
/// @param comments comments in the file header
void write_surfels(const std::filesystem::path& path, const Surfels& surfels, const FileMetadata& comments);
/// Reads a scene that write_surfels() has written. The surfels are restored bit by bit
/// and grouped by model. Models, instances and sensor drop probabilities are copied from
/// `layout`. Properties may have any order, and additional properties are allowed.
/// Ignores nx ny nz, scale_2 of surfels, and the second and third colour. Many editors
/// keep only the usual properties. Missing properties are copied from the surfels of
/// `layout` at the same positions.
/// @param primitive primitive of the file. Default: surfels
/// @param note output: text about missing properties, empty if the file has all
/// @throws DataError for text or big-endian files, sizes that do not match, or values
/// that are not finite; for missing properties of surfels that are not in `layout`
Scene read_surfel_ply(const std::filesystem::path& path, const Scene& layout, PrimitiveType primitive = {},
                      std::string* note = nullptr);

}  // namespace relidar
