# Messages, and where catkin wants things. Included by the top-level CMakeLists.txt before any target.
add_message_files(FILES BodyState.msg Contact.msg ContactArray.msg PointWrench.msg SurfaceTopology.msg)
add_service_files(FILES Step.srv)
generate_messages(DEPENDENCIES geometry_msgs std_msgs)
generate_dynamic_reconfigure_options(cfg/Live.cfg)

catkin_package(
  INCLUDE_DIRS include
  LIBRARIES bezier_fem
  CATKIN_DEPENDS
    diagnostic_msgs dynamic_reconfigure geometry_msgs message_runtime roscpp std_msgs std_srvs visualization_msgs
  DEPENDS EIGEN3)

# Programs find each other, and tests find them, in one folder
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY ${CATKIN_DEVEL_PREFIX}/${CATKIN_PACKAGE_BIN_DESTINATION})
