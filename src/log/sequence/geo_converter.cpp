// SPDX-License-Identifier: Apache-2.0
// Converts between the world of a log and positions on the earth, with PROJ.
#include <relidar/log/georeference.hpp>

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
        // Near the position, 1e-5 degrees of latitude are about a metre.
        GeodeticPosition near = georeference.position;
        near.latitude_deg -= std::copysign(1e-5, near.latitude_deg);
        if (!(glm::distance(project(near), projected_m) > 0.1))
            fail("georeference: the coordinates of {} are not metres, expected a projection to metres", crs);
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
std::string GeoConverter::wkt() const { return {}; }

#endif

}  // namespace relidar
