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

// Lu-Milios relaxation as the thesis used it: correspondences anew before each of several outer iterations.
#include "peers.h"

#include <pcl/common/transforms.h>
#include <pcl/registration/correspondence_estimation.h>
#include <pcl/registration/lum.h>

#include <fstream>

namespace {
constexpr double kMaxDistance = 0.02;  // m, of a correspondence
constexpr int kInner = 40;
}  // namespace

// FOLDER/frame_<k>.f32, FOLDER/start.txt with a pose a frame, FOLDER/<edges>.txt with two indices an edge.
void lum(const std::string& folder, int outer, const std::string& edges_name, const std::string& name) {
  const std::vector<Eigen::Matrix4f> start = read_poses(folder + "/start.txt");
  std::vector<std::pair<int, int>> edges;
  std::ifstream file(folder + "/" + edges_name + ".txt");
  for (int i, j; file >> i >> j;) edges.emplace_back(i, j);

  std::vector<Cloud::Ptr> clouds;
  for (std::size_t k = 0; k < start.size(); ++k)
    clouds.push_back(read_cloud(folder + "/frame_" + std::to_string(k) + ".f32"));

  pcl::registration::LUM<pcl::PointXYZ> network;
  for (std::size_t k = 0; k < clouds.size(); ++k) {
    Cloud::Ptr placed(new Cloud);
    pcl::transformPointCloud(*clouds[k], *placed, start[k]);
    network.addPointCloud(placed);
  }
  network.setMaxIterations(kInner);
  network.setConvergenceThreshold(0.0f);
  const std::vector<double> ms = repeat(outer, [&] {
    for (const auto& [i, j] : edges) {
      pcl::registration::CorrespondenceEstimation<pcl::PointXYZ, pcl::PointXYZ> estimation;
      estimation.setInputSource(network.getTransformedCloud(i));
      estimation.setInputTarget(network.getTransformedCloud(j));
      pcl::CorrespondencesPtr matches(new pcl::Correspondences);
      estimation.determineCorrespondences(*matches, kMaxDistance);
      if (matches->size() > 2) network.setCorrespondences(i, j, matches);
    }
    network.compute();
  });
  std::vector<Eigen::Matrix4f> poses;
  for (std::size_t k = 0; k < clouds.size(); ++k)
    poses.push_back(network.getTransformation(k).matrix() * start[k]);
  report(name, ms, "\"edges\": " + std::to_string(edges.size()) + ", \"poses\": " + json(poses));
}
