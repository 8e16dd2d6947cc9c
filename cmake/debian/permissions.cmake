# SPDX-License-Identifier: Apache-2.0
# cpack runs this script on the installed files before it packs them. It makes all files
# readable for everyone, whatever the umask of the user.
execute_process(COMMAND chmod -R u=rwX,go=rX ${CPACK_TEMPORARY_INSTALL_DIRECTORY} COMMAND_ERROR_IS_FATAL ANY)
