// SPDX-License-Identifier: Apache-2.0
// Converts between the world of a log and positions on the earth, with PROJ.
#include <relidar/log/georeference.hpp>

#include <algorithm>
#include <array>
#include <cmath>

#include <relidar/base/math.hpp>
#include "base/fail.hpp"
#ifdef RELIDAR_PROJ
#include <proj.h>
#endif

namespace relidar {

std::string local_tangent_crs(const GeodeticPosition& position) {
    return fmt::format(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 "
        "+step +proj=topocentric +ellps=WGS84 +lat_0={} +lon_0={} +h_0={}",
        position.latitude_deg, position.longitude_deg, position.height_m);
}

#ifdef RELIDAR_PROJ

bool has_proj() { return true; }

struct GeoConverter::Impl {
    explicit Impl(Georeference known) : georeference(std::move(known)) {
        // With PJ_LOG_NONE, PROJ prints a missing proj.db.
        proj_log_func(context.get(), nullptr, [](void*, int, const char*) {});
        const std::string& crs = georeference.crs;
        // PROJ computes a string with +proj, which has no datum, as it is.
        is_operation = crs.find("+proj") != std::string::npos && crs.find("+type=crs") == std::string::npos;
        if (is_operation) projection.reset(proj_create(context.get(), crs.c_str()));
        else if (const Handle created{
                     proj_create_crs_to_crs(context.get(), "EPSG:4979", crs.c_str(), nullptr)})
            projection.reset(proj_normalize_for_visualization(context.get(), created.get()));
        if (!projection && !proj_context_get_database_path(context.get()))
            fail("georeference: PROJ does not find proj.db, which describes {}; set PROJ_DATA to its folder",
                 crs);
        if (!projection)
            fail(
                "georeference: found the projection \"{}\"; expected a code such as EPSG:32632 or a PROJ "
                "string",
                crs);
        projected_m = project(georeference.position);
        check_axes();
    }
    /// Rejects projections whose coordinates are not x, y and height in metres: those of
    /// the world of a log must be right-handed, upright, and as long as on the earth.
    void check_axes() {
        constexpr double kMinScale = 0.9, kMaxScale = 1.1, kMaxTilt = 1e-3;
        const auto& [east, north, up] = compute_axes();
        if (!(std::max({std::abs(east.z), std::abs(north.z), glm::length(glm::dvec2(up))}) <= kMaxTilt))
            fail(
                "georeference: the z axis of {} does not point up at the position; expected a map "
                "projection such as EPSG:32632",
                georeference.crs);
        if (!(glm::dot(glm::cross(east, north), up) > 0.0))
            fail(
                "georeference: the axes of {} are left-handed; expected x, y and height of a right-handed "
                "map such as EPSG:32632",
                georeference.crs);
        for (const double length : {glm::length(east), glm::length(north), glm::length(up)}) {
            if (!(length >= kMinScale && length <= kMaxScale))
                fail(
                    "georeference: a metre at the position is {:.4g} units of {}; expected {} to {}: a map "
                    "of this region in metres, not in feet (3.281) or degrees",
                    length, georeference.crs, kMinScale, kMaxScale);
            if (std::abs(length - 1.0) > std::abs(scale - 1.0)) scale = length;
        }
    }
    /// Returns the steps on the map for a metre east, north and up at the position.
    std::array<glm::dvec3, 3> compute_axes() const {
        constexpr double kStep_deg = 0.5e-5;  // about half a metre
        GeodeticPosition at = georeference.position;
        at.latitude_deg = std::clamp(at.latitude_deg, -89.9, 89.9);  // The poles have no east.
        const auto step = [&](double latitude_deg, double longitude_deg, double height_m) {
            const auto place = [&](double sign) {
                return project({at.latitude_deg + sign * latitude_deg,
                                at.longitude_deg + sign * longitude_deg, at.height_m + sign * height_m});
            };
            return place(1.0) - place(-1.0);
        };
        // radii of curvature of the WGS 84 ellipsoid along a parallel and a meridian
        constexpr double kRadius_m = 6378137.0, kEccentricity2 = 0.00669437999014, kDegree = kPi / 180.0;
        const double sine = std::sin(kDegree * at.latitude_deg),
                     w = std::sqrt(1.0 - kEccentricity2 * sine * sine),
                     east_m = (kRadius_m / w + at.height_m) * std::cos(kDegree * at.latitude_deg),
                     north_m = kRadius_m * (1.0 - kEccentricity2) / (w * w * w) + at.height_m;
        const double angle_rad = 2.0 * kStep_deg * kDegree;
        return {step(0.0, kStep_deg, 0.0) / (angle_rad * east_m),
                step(kStep_deg, 0.0, 0.0) / (angle_rad * north_m), step(0.0, 0.0, 0.5)};
    }
    glm::dvec3 convert(PJ_DIRECTION direction, const glm::dvec3& from) const {
        proj_errno_reset(projection.get());
        const PJ_COORD to = proj_trans(projection.get(), direction, proj_coord(from.x, from.y, from.z, 0.0));
        if (!std::isfinite(to.xyz.x) || !std::isfinite(to.xyz.y) || !std::isfinite(to.xyz.z))
            fail("georeference: {} has no point ({}, {}, {})", georeference.crs, from.x, from.y, from.z);
        return {to.xyz.x, to.xyz.y, to.xyz.z};
    }
    /// PROJ expects radians for operations, and degrees for EPSG:4979.
    double angle_unit() const { return is_operation ? kPi / 180.0 : 1.0; }
    glm::dvec3 project(const GeodeticPosition& p) const {
        return convert(PJ_FWD, {angle_unit() * p.longitude_deg, angle_unit() * p.latitude_deg, p.height_m});
    }

    struct Deleter {
        void operator()(PJ* object) const { proj_destroy(object); }
        void operator()(PJ_CONTEXT* context) const { proj_context_destroy(context); }
    };
    using Handle = std::unique_ptr<PJ, Deleter>;
    Georeference georeference;
    std::unique_ptr<PJ_CONTEXT, Deleter> context{proj_context_create()};
    Handle projection;
    bool is_operation = false;
    glm::dvec3 projected_m{0.0};  ///< the position of the georeference
    double scale = 1.0;           ///< length of a metre there, the value that differs most from 1
};

GeoConverter::GeoConverter(const Georeference& georeference) : impl_(std::make_shared<Impl>(georeference)) {}

GeodeticPosition GeoConverter::to_geodetic(const glm::dvec3& dataset_m) const {
    const Georeference& known = impl_->georeference;
    const glm::dvec3 p =
        impl_->convert(PJ_INV, impl_->projected_m + known.rotation * (dataset_m - known.point_m));
    return {p.y / impl_->angle_unit(), p.x / impl_->angle_unit(), p.z};
}

glm::dvec3 GeoConverter::to_dataset(const GeodeticPosition& position) const {
    const Georeference& known = impl_->georeference;
    return known.point_m + glm::conjugate(known.rotation) * (impl_->project(position) - impl_->projected_m);
}

glm::dquat GeoConverter::dataset_from_enu(const GeodeticPosition& position) const {
    constexpr double kStep_deg = 1e-5;  // about a metre, so that rounding does not matter
    GeodeticPosition east = position, west = position, north = position, south = position;
    east.longitude_deg += kStep_deg;
    west.longitude_deg -= kStep_deg;
    north.latitude_deg += kStep_deg;
    south.latitude_deg -= kStep_deg;
    const glm::dvec3 x = glm::normalize(to_dataset(east) - to_dataset(west));
    const glm::dvec3 z = glm::normalize(glm::cross(x, to_dataset(north) - to_dataset(south)));
    return glm::normalize(glm::quat_cast(glm::dmat3(x, glm::cross(z, x), z)));
}

glm::dvec3 GeoConverter::to_map(const GeodeticPosition& position) const { return impl_->project(position); }

std::string GeoConverter::scale_note() const {
    constexpr double kUsualChange = 1e-3;  // UTM has at most this one in its zones
    if (std::abs(impl_->scale - 1.0) <= kUsualChange) return {};
    return fmt::format("georeference: a metre at the position is {:.4f} m on the map {}, so lengths differ",
                       impl_->scale, impl_->georeference.crs);
}

std::string GeoConverter::wkt() const {
    constexpr double kTolerance_m = 1e-3;
    const Georeference& known = impl_->georeference;
    const bool is_turned = known.rotation != glm::dquat(1.0, 0.0, 0.0, 0.0);
    const bool is_shifted =
        glm::distance(glm::dvec2(impl_->projected_m), glm::dvec2(known.point_m)) > kTolerance_m;
    if (is_turned || is_shifted) return {};  // WKT describes only the projection
    // PROJ describes an operation only if the string calls it a reference system.
    const std::string crs = known.crs + (impl_->is_operation ? " +type=crs" : "");
    const Impl::Handle described(proj_create(impl_->context.get(), crs.c_str()));
    const char* text =
        described ? proj_as_wkt(impl_->context.get(), described.get(), PJ_WKT1_GDAL, nullptr) : nullptr;
    return text ? text : "";
}

#else

bool has_proj() { return false; }

struct GeoConverter::Impl {};

GeoConverter::GeoConverter(const Georeference&) {
    fail<UsageError>(
        "relidar was built without PROJ, which converts latitudes and longitudes; install "
        "libproj-dev and build it again");
}
// The constructor always throws, so nothing calls these functions.
GeodeticPosition GeoConverter::to_geodetic(const glm::dvec3&) const { return {}; }
glm::dvec3 GeoConverter::to_dataset(const GeodeticPosition&) const { return {}; }
glm::dquat GeoConverter::dataset_from_enu(const GeodeticPosition&) const { return {}; }
glm::dvec3 GeoConverter::to_map(const GeodeticPosition&) const { return {}; }
std::string GeoConverter::scale_note() const { return {}; }
std::string GeoConverter::wkt() const { return {}; }

#endif

namespace {

/// Returns the place of a log whose world has the coordinates of a map.
Georeference place_on_map(const GeodeticPosition& position, const std::string& crs) {
    Georeference place{.position = position, .crs = crs};
    place.point_m = GeoConverter(place).to_map(position);
    return place;
}

}  // namespace

MapProjector::MapProjector(const Georeference& world, const std::string& crs)
    : world_(world), map_(place_on_map(world.position, crs)), crs_(crs) {}

glm::dvec3 MapProjector::to_map(const glm::dvec3& dataset_m) const {
    return map_.to_dataset(world_.to_geodetic(dataset_m));
}

Pose MapProjector::to_map(const Pose& dataset_pose) const {
    const GeodeticPosition position = world_.to_geodetic(dataset_pose.translation);
    return {glm::normalize(map_.dataset_from_enu(position) *
                           glm::conjugate(world_.dataset_from_enu(position)) * dataset_pose.rotation),
            map_.to_dataset(position)};
}

Pose MapProjector::dataset_from_axes(const glm::dvec3& dataset_m) const {
    return {glm::conjugate(to_map(Pose{{1, 0, 0, 0}, dataset_m}).rotation), dataset_m};
}

void MapProjector::project_points(std::vector<glm::vec3>& points_m, const Pose& dataset_from_axes) const {
    const glm::dvec3 origin_m = to_map(dataset_from_axes.translation);
    for (glm::vec3& point_m : points_m)
        point_m = glm::vec3(to_map(dataset_from_axes * glm::dvec3(point_m)) - origin_m);
}

}  // namespace relidar
