# SPDX-License-Identifier: Apache-2.0
# cpack runs this on the installed files before it packs them: everyone may read them, whatever the umask of who packs.
execute_process(COMMAND chmod -R u=rwX,go=rX ${CPACK_TEMPORARY_INSTALL_DIRECTORY} COMMAND_ERROR_IS_FATAL ANY)
