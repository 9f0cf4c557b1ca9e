// Copyright 2026 debris_scanner maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

// Pairs of clouds registered from the identity: point to point, point to plane, generalised ICP.
#include "peers.h"

#include <pcl/filters/voxel_grid.h>
#include <pcl/registration/gicp.h>
#include <pcl/registration/icp.h>

#include <fstream>

namespace {

struct Found {
  std::vector<double> ms;
  std::vector<Eigen::Matrix4f> poses;
  void tell(const std::string& name) { report(name, ms, "\"poses\": " + json(poses)); }
};

Cloud::Ptr voxel_grid(const Cloud::ConstPtr& cloud, float edge) {
  pcl::VoxelGrid<pcl::PointXYZ> grid;
  grid.setInputCloud(cloud);
  grid.setLeafSize(edge, edge, edge);
  Cloud::Ptr out(new Cloud);
  grid.filter(*out);
  return out;
}

template <typename Registration, typename Pointer>
void align(Registration& registration, const Pointer& source, const Pointer& target, Found& found, double before) {
  registration.setMaximumIterations(50);
  registration.setMaxCorrespondenceDistance(0.05);
  registration.setTransformationEpsilon(1e-8);
  registration.setInputSource(source);
  registration.setInputTarget(target);
  typename std::remove_reference<decltype(*source)>::type::Ptr aligned(
      new typename std::remove_const<typename std::remove_reference<decltype(*source)>::type>::type);
  registration.align(*aligned);
  found.ms.push_back(cpu_ms() - before);
  found.poses.push_back(registration.getFinalTransformation());
}

}  // namespace

// FOLDER/pair_<k>_source.f32 and pair_<k>_target.f32: target frames as organised clouds. A live scan prepares
// each frame once, so the time of a pair is that of one preparation and one registration.
void pairs(const std::string& folder) {
  for (const int edge_mm : {2, 4}) {
    Found icp, plane, gicp, gicp_with_normals;
    for (int k = 0;; ++k) {
      const std::string name = folder + "/pair_" + std::to_string(k);
      if (!std::ifstream(name + "_source.f32")) break;
      const Cloud::Ptr raw = read_cloud(name + "_source.f32");
      const Cloud::Ptr target = voxel_grid(read_cloud(name + "_target.f32"), edge_mm * 1e-3f);
      const NormalCloud::Ptr target_normals = with_normals(target, 20);
      double start = cpu_ms();
      const Cloud::Ptr source = voxel_grid(raw, edge_mm * 1e-3f);
      const double voxel_ms = cpu_ms() - start;
      start = cpu_ms();
      const NormalCloud::Ptr source_normals = with_normals(source, 20);
      const double normals_ms = cpu_ms() - start;

      pcl::IterativeClosestPoint<pcl::PointXYZ, pcl::PointXYZ> point_to_point;
      align(point_to_point, source, target, icp, cpu_ms() - voxel_ms);
      pcl::IterativeClosestPointWithNormals<pcl::PointNormal, pcl::PointNormal> point_to_plane;
      align(point_to_plane, source_normals, target_normals, plane, cpu_ms() - voxel_ms - normals_ms);
      pcl::GeneralizedIterativeClosestPoint<pcl::PointXYZ, pcl::PointXYZ> generalised;
      generalised.setRotationEpsilon(1e-6);  // as it comes it stops degrees away
      generalised.setRotationGradientTolerance(1e-5);
      generalised.setTranslationGradientTolerance(1e-5);
      generalised.setMaximumOptimizerIterations(50);
      align(generalised, source, target, gicp, cpu_ms() - voxel_ms - normals_ms);
    }
    const std::string suffix = " " + std::to_string(edge_mm) + " mm";
    icp.tell("voxel grid, ICP" + suffix);
    plane.tell("voxel grid, normals, point to plane" + suffix);
    gicp.tell("voxel grid, normals, GICP" + suffix);
  }
}
